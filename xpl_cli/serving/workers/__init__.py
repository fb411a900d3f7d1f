"""Workers of the front end: their processes, queues and failures."""

"""Search for the mistake of an adapter: its actions under each candidate mistake, scored and ranked."""

"""The command line as tools of the Model Context Protocol. A tool is a command: the same options, the same answer."""

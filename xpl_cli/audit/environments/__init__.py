"""Environment packages on the stage of an audit."""

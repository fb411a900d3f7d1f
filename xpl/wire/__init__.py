"""Values as bytes: frames of msgpack, packed values, arrays, and memory that processes share."""

"""Access control: limits on connections and memory, tokens, host names and origins."""

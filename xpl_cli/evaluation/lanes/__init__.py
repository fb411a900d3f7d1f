"""Where episodes are played: lanes on this machine or on a cluster, and the servers beside them."""

"""Rollout workers, on this machine or on a cluster, and the policy servers that they use."""

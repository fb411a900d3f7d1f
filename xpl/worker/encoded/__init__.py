"""Changes of what an adapter's `encode` makes of observations, tried one after another in the policy's interpreter."""

"""What runs in the policy's interpreter: it loads an adapter, or what stands in for it, and answers the front end."""

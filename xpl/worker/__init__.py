"""Code in the policy's interpreter: it loads an adapter, or its shadow, and answers the server's front end."""

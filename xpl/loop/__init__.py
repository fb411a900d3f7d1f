"""An adapter's evaluation loop in a separate process, with proxies of environment and client."""

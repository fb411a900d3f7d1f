"""The conventions that an adapter and its model have to share, each in a module of its own (`xpl.catalogue`)."""

from xpl_like import nothing  # noqa: F401

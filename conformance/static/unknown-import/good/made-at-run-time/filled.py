for name in ("Entry", "Table"): globals()[name] = type(name, (), {})

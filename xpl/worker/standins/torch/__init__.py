"""A small torch on numpy: what adapters do around a model, with torch's dtypes, devices and refusals.

Only where torch is not installed. Everything lies in the memory of this machine, whatever device it is said to be on.
bfloat16 is kept as float32 and, as in torch, has no numpy array.
"""

try:
    from .model import *
except ImportError:
    pass

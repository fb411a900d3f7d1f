from my_policy.adapter import MyPolicy as Model

__all__ = ["Model"]

def get_model(config):
    from .model import Model

    return Model(config)

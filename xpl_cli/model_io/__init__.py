"""The model's own inputs and outputs: golden pairs, pictures of inputs, kinematics."""

"""What a model itself says, beside what its adapter makes of it: golden pairs, pictures of inputs, kinematics."""

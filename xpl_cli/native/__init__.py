"""What a model itself says, beside what its adapter makes of it: native pairs, pictures of inputs, kinematics."""

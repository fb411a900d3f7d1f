"""Our own modules that stand where the ecosystem's would be. Python 3.9 and numpy; written from what adapters call.

Where the known behaviour is wrong these are right: the arm of a robot with one arm is `arm_joint_state`, and a pose has
seven values however many joints the arm has.
"""

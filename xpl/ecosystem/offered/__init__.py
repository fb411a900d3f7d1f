"""Replacements of the ecosystem's modules, written from the calls of adapters. Python 3.9 and numpy.

Known errors of the originals are corrected: the arm of a robot with one arm is `arm_joint_state`, and a pose has seven
values however many joints the arm has.
"""

"""Kinematics as a witness: joints and poses that were recorded together tell how either is written."""

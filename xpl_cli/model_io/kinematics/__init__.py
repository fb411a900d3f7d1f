"""Kinematic consistency: joints and poses that were recorded together determine their conventions."""

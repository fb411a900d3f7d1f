"""Conversions between the standard and what a model itself speaks, compiled from the block `native` of policy.yml.

    interface = compile_interface(manifest["native"], embodiment, action_type, folder=package)
    inputs = interface.batch([[interface.encode(obs)]])        # the model's names and numbers
    steps = interface.decode(answer, obs)                      # the standard's action steps

Every word of the block is defined in spec/v1/native.schema.json, with its formula and its source.
"""

from __future__ import annotations

from xpl.convert.interface import Interface, Memory, NativeError, compile_interface

__all__ = ["Interface", "Memory", "NativeError", "compile_interface"]

"""Conversions between the standard and what a model itself speaks, compiled from the block `model_io` of policy.yml.

    interface = compile_interface(manifest["model_io"], embodiment, action_type, folder=package)
    inputs = interface.batch([[interface.encode(obs)]])        # the model's names and numbers
    steps = interface.decode(answer, obs)                      # the standard's action steps

Every word of the block is defined in spec/v1/model_io.schema.json, with its formula and its source.
"""

from __future__ import annotations

from xpl.convert.interface import ConversionError, Interface, Memory, compile_interface

__all__ = ["ConversionError", "Interface", "Memory", "compile_interface"]

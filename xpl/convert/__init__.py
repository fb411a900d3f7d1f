"""Conversions between the standard and a model's inputs and outputs, compiled from the block `model_io` of policy.yml.

    interface = compile_interface(manifest["model_io"], embodiment, action_type, folder=package)
    inputs = interface.batch([[interface.encode(obs)]])        # model inputs by name
    steps = interface.decode(answer, obs)                      # action steps of the standard

spec/v1/model_io.schema.json defines every key of the block, with its formula and its source.
"""

from __future__ import annotations

from xpl.convert.interface import ConversionError, Interface, Memory, compile_interface

__all__ = ["ConversionError", "Interface", "Memory", "compile_interface"]

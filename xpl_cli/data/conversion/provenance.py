"""Provenance of a converted dataset: what is needed to convert it back."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final, Self

from xpl_cli.basics.errors import ExitCode
from xpl_cli.data.conversion import packing
from xpl_cli.data.formats.writing import CONVERTED
from xpl_cli.data.sets import documents
from xpl_cli.data.sets.errors import DataError

if TYPE_CHECKING:
    from xpl_cli.data.sets.interface import Demonstrations

_WIDTH: Final = {"type": "integer", "minimum": 1, "maximum": 1 << 20}
_SCHEMA: Final = documents.schema_text(
    {
        "type": "object",
        "properties": {
            "from": {"type": "string"},
            "names": {"type": "object", "additionalProperties": {"type": "string", "minLength": 1, "maxLength": 200}},
            "numbers": {"type": "array", "items": {"type": "string"}},
            packing.NAME: {
                "type": "object",
                "additionalProperties": {
                    "type": "array",
                    "minItems": 1,
                    "items": {
                        "type": "array",
                        "minItems": 2,
                        "maxItems": 2,
                        "prefixItems": [{"type": "string", "minLength": 1, "maxLength": 200}, _WIDTH],
                    },
                },
            },
        },
    }
)


@dataclass(frozen=True)
class Provenance:
    """What a converted dataset records of its source.

    Attributes:
        format: of the source; "" where none is recorded.
        names: the source's names, by the dataset's names.
        numbers: columns that were scalars.
        layout: how series were packed; None where they were not.
    """

    format: str = ""
    names: Mapping[str, str] = field(default_factory=dict)
    numbers: frozenset[str] = frozenset()
    layout: packing.Layout | None = None

    @classmethod
    def of(cls, dataset: Demonstrations) -> Self:
        """Read the provenance of a dataset.

        Raises:
            DataError: the record does not match the schema that conversions write.
        """
        record = dataset.extras.get(CONVERTED)
        if not isinstance(record, Mapping):
            return cls()
        try:
            documents.validate_value(record, _SCHEMA, f"{dataset.path}: {CONVERTED}")
        except DataError as error:
            raise DataError(str(error), code=ExitCode.FINDINGS) from None
        packed = record.get(packing.NAME)
        layout = None if packed is None else {name: [(p, int(w)) for p, w in parts] for name, parts in packed.items()}
        return cls(record.get("from", ""), record.get("names", {}), frozenset(record.get("numbers", ())), layout)

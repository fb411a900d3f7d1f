"""The scaffold of reference.py: what the manifest says in the standard's words, and nothing of the model."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from xpl import _spec as sdk
from xpl import get_embodiment
from xpl_cli.basics.content import room
from xpl_cli.packages.conventions import applying
from xpl_cli.packages.package import POLICY
from xpl_cli.standard import spec

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from xpl import Embodiment
    from xpl.manifest import Manifest


def said(manifest: Manifest) -> dict[str, Any]:
    """Return what the template says: conventions that apply, fields that are read, and the keys of an action step.

    Raises:
        UnknownEmbodimentError: if the manifest names no robot that there is.
    """
    robot = get_embodiment(next(iter(manifest.embodiments), ""))
    action = robot.dims(next(iter(manifest.action_types), sdk.DEPLOY_DEFAULTS[sdk.Deploy.ACTION_TYPE]))
    words = spec.schema("model_io")["$defs"]["convention"]["oneOf"]
    applies = applying(manifest)
    return {
        "name": manifest.name,
        "placeholder": spec.data("package")["placeholder"],
        "conventions": {word["const"]: word["description"] for word in words if word["const"] in applies},
        "fields": list(_fields(manifest.read, robot)),
        "action": action,
        "chunk": manifest.temporal.chunk or 1,
    }


def text(manifest: Manifest) -> str:
    """Return reference.py of a package, to be filled in.

    Raises:
        UnknownEmbodimentError: as `said`.
    """
    import jinja2

    template = room("templates") / POLICY / "files" / f"{spec.data('package')['files']['reference']}.jinja"
    environment = jinja2.Environment(
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
        autoescape=False,  # noqa: S701 - Python, not HTML
    )
    return environment.from_string(template.read_text(encoding="utf-8")).render(second=said(manifest))


def _fields(read: Sequence[str], robot: Embodiment) -> Iterator[tuple[str, str, str]]:
    """Yield the fields of an observation that a policy reads: a name, how it is read, and what it is."""
    state = sdk.Obs.STATE
    keys = [name.removeprefix(f"{state}.") for name in read if name.startswith(f"{state}.")]
    if keys:
        yield state, f'["{state}"]', ", ".join(_numbers(keys, robot))
    for name in read:
        group, _, camera = name.partition(".")
        if group == sdk.Obs.VISION:
            yield camera, f'["{group}"]["{camera}"]["{sdk.Camera.COLOR}"]', "(H, W, 3) uint8 RGB"
        elif group == sdk.Obs.INSTRUCTION:
            yield group, f'.get("{group}", "")', "text"


def _numbers(keys: Sequence[str], robot: Embodiment) -> Iterator[str]:
    """Yield keys of the state without their arm, with their dimensions; and which arms they are of."""
    dims = {held: width for kind in sdk.ACTION_TYPES for held, width in robot.dims(kind).items()}
    prefixes: dict[str, None] = {}
    for key in keys:
        of_key = {held: width for held, width in dims.items() if held.endswith(key)}
        prefixes |= dict.fromkeys(held.removesuffix(key) for held in of_key)
        yield f"{key} {' or '.join(f'({width},)' for width in dict.fromkeys(of_key.values()))}"
    if any(prefixes):
        yield f"each with {' and '.join(prefixes)}"

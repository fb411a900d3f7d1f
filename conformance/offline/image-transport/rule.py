"""XPL225: Actions depend on how an image was encoded."""

from __future__ import annotations

from collections.abc import Iterator

from xpl import _spec as sdk
from xpl_cli.audit import Finding, Fix, NotApplicable, rule
from xpl_cli.audit.offline.in_process_run import InProcessRun
from xpl_cli.audit.offline.semantics import Semantics
from xpl_cli.audit.served.changed_inputs import present
from xpl_cli.audit.served.compare import difference, first_step, is_answer_list
from xpl_cli.audit.served.probe import Probe, blame
from xpl_cli.audit.served.transports import FORMS, LEGACY, decoded, encoded, error_of, sees_pictures


@rule(code="XPL225", requirement="XPL-IMG-2", compares=True, tries="encoded images")
def image_transport(probe: Probe, in_process_run: InProcessRun, semantics: Semantics) -> Iterator[Finding]:
    """Actions depend on how an image was encoded.

    ## What it does
    Sends the same images as arrays, as JPEG with the marker of the standard, as JPEG of the older kind, with red and
    blue swapped, and as true-RGB PNG, and compares each action with that for an array of exactly the decoded image, so
    that the codec's own error does not count. Then it passes the encoded bytes to the adapter: it must refuse them, or
    decode them as the standard does. An adapter without a manifest only gets JPEG of the older kind, as its benchmarks
    send it.

    ## Why it matters
    The encoding is a question of bandwidth. If it changes colours, a policy scores lower with one benchmark than with
    another, without any error.

    ## Example
    `cv2.imdecode(color, 1)` for encoded frames, in BGR, and the array itself for raw ones.

    ## Use instead
    `xpl.observation.get_image(obs, camera)`: the server has already decoded the image.

    ## Fix safety
    No automatic fix.
    """
    if not sees_pictures(probe):
        raise NotApplicable("the manifest declares no camera as an input")
    probe.require_answer()
    raw = probe.observation()
    plain = probe.answer(raw)
    for name in FORMS:
        sent = encoded(raw, name)
        read = decoded(sent)
        error = error_of(raw, read)
        expected = probe.answer(read) if error else plain
        ways = [("sent through the server", expected, probe.answer(sent))]
        decoded_answer, undecoded = in_process_run.image_answers[name]
        # To refuse is right: an adapter never decodes. One of the field knows no more than the older kind.
        is_known = name == LEGACY or bool(probe.package.manifest)
        if is_known and probe.repeats_in_place and decoded_answer.error is None and undecoded.error is None:
            ways.append(("handed over undecoded", decoded_answer.result, undecoded.result))
        for way, reference, answer in ways:
            mismatch = difference(reference, answer)
            if mismatch is not None:
                yield blame(
                    f"images as {name}, {way}, give other actions than the same images as arrays: colours "
                    "depend on the encoding",
                    expected=f"the actions for the decoded images, which the codec changed by at most {error} of 255",
                    got=mismatch,
                    evidence={
                        "form": name,
                        "codec_error": error,
                        "raw": first_step(plain) if is_answer_list(plain) else None,
                        "decoded": first_step(reference) if is_answer_list(reference) else None,
                        "encoded": first_step(answer) if is_answer_list(answer) else None,
                    },
                    fix=Fix("advice", "read images with xpl.observation.get_image, and decode nothing in the adapter"),
                )
                return
    cameras = {name for name in present(raw) if name.startswith(sdk.Obs.VISION)}
    if cameras <= semantics.known_ignored_inputs():
        raise NotApplicable("the actions depend on no image: how one was encoded cannot be seen in them")

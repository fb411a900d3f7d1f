"""What things are worth by their names, where only the name says what is meant: sizes, statistics, verbs.

Data. The kinds of models that repeat use these words; an adapter's own numbers (deploy.yml) come first.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any, Callable

import numpy as np

from xpl import _spec as spec


class Facts:
    """Sizes that a stand-in needs.

    Attributes:
        steps: actions of a chunk.
        width: columns of an action.
        low, high: range of each column, (width,) each.
        numbers: numbers of the adapter's configuration, by their names.
        parts: how wide a part of an action is, by what its name says.
        quaternions: first columns of quaternions.
        widths: how wide a model's actions may be, where it says other than the robot; the likeliest first.
    """

    def __init__(
        self,
        steps: int,
        width: int,
        low: np.ndarray,
        high: np.ndarray,
        numbers: Mapping[str, float] | None = None,
        widths: tuple[int, ...] = (),
    ) -> None:
        self.steps, self.width, self.low, self.high = steps, width, low, high
        self.numbers = dict(numbers or {})
        self.widths = widths or (width,)
        self.parts: tuple[tuple[str, int], ...] = ()
        self.quaternions: list[int] = []

    def worth(self, name: str, path: str = "") -> Any:
        """Return the number, or the numbers, that a name stands for; None where it says nothing."""
        words = name.lower()
        if "shape_meta" in path and words in _SHAPES:
            return [
                {"key": key, "raw_shape": shape or self.width, "shape": shape or self.width}
                for key, shape in _SHAPES[words]
            ]
        if words in self.numbers:
            return self.numbers[words]
        for pattern, value in _WORTH:
            if pattern.fullmatch(words):
                found = value(self)
                part = next((count for part, count in self.parts if part in path.lower()), None)
                return found[:part] if isinstance(found, np.ndarray) and part is not None else found
        return None


_REACH = 2.0  # of statistics: no joint is cut off, and what answers mean twice over is still an opening of a gripper
_SHAPES: dict[str, list[tuple[str, Any]]] = {
    "images": [(f"{place}_rgb", [3, 480, 640]) for place in ("head", "left_wrist", "right_wrist")],
    "state": [("default", None)],
    "action": [("default", None)],
}
"""What a data set of hydra's configurations says of its columns."""


def _pattern(text: str) -> re.Pattern[str]:
    return re.compile(text)


_WORTH: list[tuple[re.Pattern[str], Callable[[Facts], Any]]] = [
    (_pattern(words), value)
    for words, value in (
        (
            r"(image|img|cam|camera|obs_cam|vision|video)_(keys|names|features)",
            lambda _: [f"observation.images.{name}" for name in ("cam_high", *spec.CAMERAS[2][1:])],
        ),
        (r"(.*_)?(action_)?chunk_size|n_action_steps", lambda facts: facts.numbers.get("replan_steps", facts.steps)),
        # statistics that change little
        (r"(.*[_.])?(mean|median)(_abs)?", lambda facts: np.zeros(facts.width, np.float32)),
        (r"(.*[_.])?(std|scale|var)(_abs)?", lambda facts: np.ones(facts.width, np.float32)),
        (
            r"(.*[_.])?(min|low|lower|q0?1|q_01|percentile_1|p0?1)",
            lambda facts: np.full(facts.width, -_REACH, np.float32),
        ),
        (
            r"(.*[_.])?(max|high|upper|q99|q_99|percentile_99|p99)",
            lambda facts: np.full(facts.width, _REACH, np.float32),
        ),
        (r"mask|action_mask", lambda facts: np.ones(facts.width, bool)),
        # lists over the steps
        (r"(action_)?(delta_)?indices", lambda facts: list(range(facts.steps))),
        # sizes of a chunk
        (r"future_action_window(_size)?", lambda facts: facts.steps - 1),
        (
            (
                r"(.*_)?(chunk|chunk_size|chunk_len|action_horizon|horizon|pred_horizon|num_queries|n_action_steps"
                r"|action_size|num_actions|num_actions_chunk|action_steps|replan_steps|action_chunk_size"
                r"|action_length|open_loop_steps)"
            ),
            lambda facts: facts.steps,
        ),
        (r"(max|padded|model)_(state|action|proprio|joint)_?dim", lambda facts: max(32, facts.width)),
        (r"(.*_)?(state|action|proprio|native|joint|robot|qpos)_(dim|size|token_dim)", lambda facts: facts.width),
        # sizes that networks commonly have
        (r"(.*_)?(resize_imgs_with_padding|image_resolution|resize_size)", lambda _: (224, 224)),
        (r"(.*_)?(image_size|resolution|img_size|input_size|crop_size|default_image_size|height|width)", lambda _: 224),
        (r"(.*_)?num_patches", lambda _: 256),
        (r"(.*_)?(hidden_size|embed_dim|feature_dim|token_dim|hidden_dim)", lambda _: 64),
        (r"(.*_)?(max_length|max_len|seq_len|sequence_length|model_max_length)", lambda _: 64),
        (r"(.*_)?(num|n)_(views|cameras|images|images_in_input)", lambda _: 3),
        (r"(.*_)?(n_obs_steps|obs_horizon|history_size|img_history_size|obs_steps)", lambda _: 1),
        (r"(.*_)?(num_history_frames|n_history)|max_timesteps|episode_length", lambda _: 0),
        (r"(.*_)?(vocab_size)", lambda _: 32000),
        (r"(.*_)?(fps|freq|frequency|hz|ctrl_freq)", lambda _: 25),
        (r"(.*_)?(stride|interval|device_count|world_size|num_samples|batch_size)", lambda _: 1),
        (r"(.*_)?((pad|eos|bos|unk|sep|cls)_token_id|rank|step|index|idx|t|iter|count)", lambda _: 0),
        (r"threshold|temperature|(.*_)?scale_factor|dropout", lambda _: 1),
    )
]

STATISTICS = _pattern(r"stat|norm")
STATISTIC = ("mean", "std", "min", "max", "q01", "q99", "mask")
"""What statistics of a data set hold, for each column."""
RESETS = _pattern(r"_*(reset|clear|flush)(_.*|)")
SAME = frozenset(
    (
        "to cuda cpu eval train half float double bfloat16 type requires_grad_ detach clone contiguous compile freeze "
        "with_options share_memory tie_weights merge_and_unload "
    ).split()
)
"""Methods that return what they were called on."""
TRANSFORMS = _pattern(
    r"_*(un|de|re)?(normali[sz]e|normali[sz]er|norm|normlization)(_.*|r)?|.*(transform(?!er)|process|resi[sz]e|pad|crop|convert|backward"
    r"|collate|prepare|to_pil|to_tensor|normali[sz]e|unnorm|reorder|layout|smooth|cast|stack|preserve|compose|sanitize"
    r"|quat|matrix|rotation|pose|frame_|batch_to|to_device|dict_apply|tree_map|wrap|rgb|bgr).*"
)
"""Functions that make a value of the value that they were given; a stand-in gives it back."""
ANSWERS = _pattern(
    r"_*((?!set_|load_|build_|get_norm|make_|create_).*(predict|infer|action|sample|generate|select|forward|rollout|__call__)"
    r".*|act|step|run|query|solve|chunk|.*policy.*)"
)
"""Functions that answer with actions."""
EMBEDS = _pattern(
    r"(?i).*(encoder(model)?|embed(der|ding|s)?|tower|backbone|tokenizer_vae|vae|encode_.*|.*features?|encode)|last_hidden_state"
    r"|hidden_states?|pooler_output|.*_embeds?"
)
"""What gives features of an image or a text."""
ENCODERS = _pattern(r"tokeni[sz]|processor")
"""What gives a map of what a model reads, from texts and images."""
TOKENS = _pattern(r".*(token|input_ids|_ids|ids|attn_mask|attention_mask|lang_mask|img_mask|.*_masks?)")


def declared(config: Mapping[str, Any], pattern: str) -> list[int]:
    """Return the whole numbers of a configuration whose names match, in its order."""
    words = re.compile(pattern)
    return [
        int(value)
        for name, value in config.items()
        if isinstance(value, int) and not isinstance(value, bool) and value > 0 and words.fullmatch(str(name).lower())
    ]

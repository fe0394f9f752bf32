"""What speaks against a hit: the evidence that is worse than that of right hits, in sentences."""

from __future__ import annotations

from collections.abc import Callable, Mapping

_MOST = 3
_WEIGHTY = 0.7  # loss of the logarithm of the odds against the mean of right hits from which evidence is named

_SENTENCES: Mapping[str, Callable[[Mapping[str, float]], str]] = {
    "solid_share": lambda f: f"{f['past_share']:.0%} of the rays towards it go through it",
    "past_share": lambda f: f"{f['past_share']:.0%} of the rays towards it go through it",
    "before_share": lambda f: f"{f['before_share']:.0%} of the rays towards it end before it",
    "explained_share": lambda f: f"{1.0 - f['explained_share']:.0%} of the points about it do not lie on it",
    "closed": lambda f: "there are points where it should be empty",
    "rms_ratio": lambda f: f"its points lie {f['rms']:.1f} standard deviations off its surface",
    "part_share": lambda f: "a part of it that should be seen is not",
    "n_hits": lambda f: "few rays end on it",
    "size_score": lambda f: "its sizes are unusual",
    "flat_share": lambda f: "its points lie on one plane",
    "flats_share": lambda f: "its points lie on two planes, as on a box",
    "margin": lambda f: "it may as well point the other way",
    "lead": lambda f: "a box, a cylinder or a solid block explains the rays as well",
}


def list_doubts(
    weights: Mapping[str, float],
    usual: Mapping[str, float],
    inputs: Mapping[str, float],
    features: Mapping[str, float],
) -> tuple[str, ...]:
    """Return what speaks against a hit, most weighty first.

    Args:
        weights: of the curve, by input.
        usual: mean inputs of right hits.
        inputs, features: of the hit.
    """
    loss = {key: weights[key] * (usual[key] - inputs[key]) for key in _SENTENCES if key in weights}
    named = sorted((key for key in loss if loss[key] > _WEIGHTY), key=lambda key: -loss[key])
    return tuple(dict.fromkeys(_SENTENCES[key](features) for key in named))[:_MOST]

"""One kind of effect in every joint, as one competitor: a finding is a kind, and the search asks one place after the other.

What acts in all channels at once, as a late clock does, would else win over friction: more than the friction of any one joint,
and far less than that of all of them.
"""

from collections.abc import Iterable, Mapping

from galen_hw.diagnosis.estimation.normal_equations import Score, Scorer


def in_each_joint(scorer: Scorer, scores: Mapping[int, Score], among: Iterable[int]) -> tuple[float, list[int]]:
    """Return the rank of the best kind that joints have one by one, and where its hypotheses stand, best first.

    Each of them acts in a channel of its own, so that their ranks add up: every one pays for its parameters and its places.

    Args:
        scores: by number of hypothesis; among: numbers of those that are asked.
    """
    kinds: dict[str, dict[int, int]] = {}
    for i in sorted(among, key=lambda i: -scores[i].rank):
        h = scorer.library[i]
        if h.effect is not None and h.effect.lasting() and h.effect.joints and len(h.raw.channels) == 1:
            kinds.setdefault(h.effect.KEY, {}).setdefault(h.raw.channels[0], i)
    each = [(sum(scores[i].rank for i in places.values()), list(places.values())) for places in kinds.values()]
    return max(each, default=(0.0, []))


def kind_first(scorer: Scorer, scores: Mapping[int, Score], able: list[int]) -> list[int]:
    """Return what is to be asked before the first of the able: the best place of a kind that in all joints ranks above it."""
    rank, places = in_each_joint(scorer, scores, able)
    return places[:1] if rank > scores[able[0]].rank else []

"""One kind of effect in every joint as one competitor: a finding is a kind, and the search tests place after place.

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
    each = [(sum(scores[i].rank for i in places), places) for places in _by_kind(scorer, scores, among).values()]
    return max(each, default=(0.0, []))


def with_its_kind(scorer: Scorer, scores: Mapping[int, Score], i: int) -> float:
    """Return the rank of a hypothesis, with the best of its kind in the other joints if it is one that joints have one by one."""
    effect, own = scorer.library[i].effect, scorer.library[i].raw.channels
    others = [j for j, s in scores.items() if s.rank > 0.0 and scorer.library[j].raw.channels != own]
    alike = () if effect is None else _by_kind(scorer, scores, [i, *others]).get(effect.KEY, ())
    return sum(scores[j].rank for j in alike) if i in alike else scores[i].rank


def _by_kind(scorer: Scorer, scores: Mapping[int, Score], among: Iterable[int]) -> dict[str, list[int]]:
    """Return by kind where the best hypothesis of each joint stands, best first, of kinds that joints have one by one."""
    kinds: dict[str, dict[int, int]] = {}
    for i in sorted(among, key=lambda i: -scores[i].rank):
        h = scorer.library[i]
        if h.effect is not None and h.effect.lasting() and h.effect.joints and len(h.raw.channels) == 1:
            kinds.setdefault(h.effect.KEY, {}).setdefault(h.raw.channels[0], i)
    return {key: list(places.values()) for key, places in kinds.items()}


def kind_first(scorer: Scorer, scores: Mapping[int, Score], able: list[int]) -> list[int]:
    """Return what is to be asked before the first of the able: the best place of a kind that in all joints ranks above it."""
    rank, places = in_each_joint(scorer, scores, able)
    return places[:1] if rank > scores[able[0]].rank else []

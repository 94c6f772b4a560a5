"""What a diagnosis says in plain words."""

import re
from collections.abc import Iterable, Sequence

from designlab.inference.diagnosis.result import Control, Found, GapReport, Level, Unexplained, Where
from designlab.inference.diagnosis.verdict.confidence import SURE_ENOUGH
from designlab.inference.diagnosis.verdict.led_layout import NAME as LAYOUT
from designlab.report.effect_words import told

SPREAD = 1.5  # times the mean of its channel and frames, from which a region stands out
MOST_PLACES = 3
ONE_CHANNEL = 0.6
FRAMES = {"press": "in presses", "background": "on the untouched gel", "dark": "with the LEDs off"}
EVEN_Z = 0.5  # mean in standard deviations below which a region is neither brighter nor darker
PASSES = 0.02  # of the squared residual: less beyond noise, grain and smooth errors is nothing
SEEN = 0.05  # of the excess: less is not worth a sentence
CALIBRATED = (
    "the share of right names among those that looked like it on generated sets with known answers, less "
    "where frames are missing, few or doubtful"
)
FEW_SENSORS = (
    "all of four made sensors were told right, less where frames are missing, few or doubtful; no effect was "
    "tried beside it"
)
MANY = 3  # effects from which a sentence with the values of all is too long
ONE_PICTURE = "of one picture; nothing is known of how often such names are right"
USUAL = "noise, grain and smooth errors of light"
OF_CLEAN = "noise and what the simulation may be wrong by"  # the same where frames have no grain
OF_ONE_PICTURE = "its grain and what the simulation may be wrong by"  # the same of a single picture
SMOOTH = "boards, walls, gaps between LEDs, uneven coating"
GRAIN = "dust, compression, sampling of a simulation"
EDGES = "shape of the probe, pose, contact"
OUTSIDE = (
    "dirt or a hair on the gel, a second contact, marks printed on it, a reflection of an LED in the lens, "
    "another object than stated, pictures that were compressed"
)

ONE = (
    "n = 1: one picture of one press. Alternate blocks of it were fitted to and the others scored, which "
    "shows that a correction is no fit to dirt, not that it holds for another press: the effects are "
    "consistent with this picture, none is validated.",
    "The noise floor is unknown without repeats; the grain of the picture itself, dirt included, stands for "
    "it.",
)


def statement(report: GapReport) -> tuple[str, ...]:
    """The verdict in sentences: what is missing, how sure, how much of the gap is gone, what to do."""
    final = report.gap["final"]
    said = [_missing(report), *_how_sure(report)]
    if others := [reserve for reserve in report.reserves if reserve not in report.barred]:
        said.append(f"With reserve: {'; '.join(others)}.")
    if report.effects:
        said.append(_gone(final, report.control, report.effects))
    rest = report.unexplained
    if rest is not None and report.verdict != "at_floor" and (rest.share is None or rest.share >= SEEN):
        said.append(left(rest, named=bool(report.effects)))
    if report.verdict != "at_floor" and report.where:
        said.append(places(report.where))
    said.extend(_to_do(report))
    if "blocks" in report.provenance:
        said = [text.replace("final presses", "final blocks of the picture") for text in said]
        said = [text.replace(USUAL, OF_ONE_PICTURE) for text in said]
        said.append("n = 1: one picture of one press. What was found is consistent with it, not validated.")
    elif rest is not None and not rest.grain_rms:
        said = [text.replace(USUAL, OF_CLEAN) for text in said]
    return tuple(text for text in said if text)


def _missing(report: GapReport) -> str:
    final = report.gap["final"]
    effects = _all(report.effects, report)
    if report.verdict == "named":
        first, *others = report.effects
        surer = [first, *(effect for effect in others if effect.confidence >= SURE_ENOUGH)]
        said = f"The model lacks {_all(surer, report)}."
        doubtful = [effect for effect in others if effect.confidence < SURE_ENOUGH]
        if doubtful:
            said += f" It may lack {_all(doubtful, report)} too, but that is more likely wrong than right."
        return said
    if report.verdict == "ambiguous":
        choices = "; ".join(
            " or ".join(effect.coherence_set) for effect in report.effects if len(effect.coherence_set) > 1
        )
        certain = [effect for effect in report.effects if len(effect.coherence_set) == 1]
        beside = f"{_all(certain, report)}, and " if certain else ""
        return (
            f"The model lacks {beside}one of several effects that these frames do not tell apart: {choices}."
        )
    if report.barred:
        return (
            f"The model may lack {effects}, but this measurement is too weak to be sure: "
            f"{'; '.join(report.barred)}."
        )
    if report.verdict == "partial":
        if "blocks" not in report.provenance and report.effects[0].confidence < SURE_ENOUGH:
            return f"The model may lack {effects}, but that is more likely wrong than right."
        return (
            f"Part of the gap is explained: the model lacks {effects}. The rest is more than {USUAL} leave."
        )
    if report.verdict == "at_floor":
        return (
            "Simulation and measurement agree: the squared residual on the final presses is "
            f"{final.before / final.floor:.2g} times what noise and the errors granted to the simulation "
            "leave."
        )
    if "blocks" not in report.provenance and final.after - final.usual < PASSES * final.after:
        return (
            "No effect of the catalogue is seen. The squared residual on the final presses is "
            f"{number(final.after / final.floor)} times its floor, but all of it passes for {USUAL}, which "
            "every sensor has."
        )
    return (
        "The gap is real but unexplained: the squared residual on the final presses is "
        f"{number(final.before / final.floor)} times its floor, and no effect of the catalogue takes enough "
        "of it "
        "away on presses it was not fitted to."
    )


def _all(effects: Sequence[Found], report: GapReport) -> str:
    """Effects with their values; those of a report of many by name alone, see `_how_sure`."""
    many = len(report.effects) >= MANY
    names = [effect.name if many else _called(effect) for effect in effects]
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)


def _called(effect: Found) -> str:
    what = _does(effect)
    return f"{effect.name} ({what})" if what else effect.name


def _does(effect: Found) -> str:
    return told(effect) or effect.summary


def _how_sure(report: GapReport) -> list[str]:
    """How sure each effect is; of many, what it does besides, since the first sentence names them alone."""
    said = []
    meaning = f" ({ONE_PICTURE if 'blocks' in report.provenance else CALIBRATED})"
    for effect in report.effects:
        if effect.name == LAYOUT:
            said.append(f"Confidence in {effect.name}: {effect.confidence:.2f} ({FEW_SENSORS}).")
            continue
        others = [name for name in effect.coherence_set if name != effect.name]
        alone = f"not ruled out: {', '.join(others)}" if others else "no other effect tried does as well"
        sure = f"{effect.confidence:.2f}{meaning}; {alone}."
        if len(report.effects) >= MANY:
            said.append(f"{effect.name}: {_does(effect)}. Confidence: {sure}")
        else:
            said.append(f"Confidence in {effect.name}: {sure}")
        meaning = ""
    return said


def _gone(final: Level, control: Control | None, effects: Sequence[Found]) -> str:
    removed = final.removed
    if removed is None:
        return "On the final presses, which decided nothing, there was no gap to begin with."
    share = "All" if removed >= 1 else percent(removed)
    said = (
        f"{share} of the gap is gone on the final presses, which decided nothing: squared residual "
        f"{number(final.before)} before, {number(final.after)} after, where {USUAL} leave "
        f"{number(final.usual)}."
    )
    if control is not None:
        own = sum(len(effect.parameters) for effect in effects)
        said += (
            f" A wrong effect fitted in the same way, {control.name} "
            f"({count(control.parameters, 'parameter')} "
            f"against {own}), {taken(control.removed)}."
        )
    return said


def left(rest: Unexplained, *, named: bool) -> str:
    """What effects leave, if any were named, of all that noise and grain do not, and what it looks like."""
    said = []
    if rest.share is not None and named:
        ends = None if rest.low is None or rest.high is None else between(rest.low, rest.high)
        interval = f" ({ends})" if ends and "to" in ends else ""
        said.append(
            f"Of all that is beyond noise and grain, smooth errors of light included, {percent(rest.share)}"
            f"{interval} is left."
        )
    size = f", {percent(rest.smooth_rms)} of it" if rest.smooth_rms else ""
    looks = {
        "smooth": f"a smooth departure of each group's light{size}: {SMOOTH}",
        "grain": f"grain of single frames, {percent(rest.grain_rms)} of their light: {GRAIN}",
        "edges": f"at the edges of presses: {EDGES}",
    }
    parts = [
        f"{percent(rest.parts[kind])} {words}"
        for kind, words in looks.items()
        if rest.parts.get(kind, 0.0) >= SEEN
    ]
    if parts:
        said.append(f"{'What is left' if named else 'It'} looks like this: {'; '.join(parts)}.")
    if rest.group is not None:
        said.append(f"Light of the LED group {rest.group} alone leaves far more than that of the others.")
    if rest.frame is not None:
        said.append(f"Frame {rest.frame} leaves far more than the others: look at it.")
    return " ".join(said)


def between(low: float, high: float) -> str:
    """Write an interval of shares.

    Examples
    --------
    >>> between(0.08, 0.16)
    '8 to 16 %'
    >>> between(0.131, 0.132)
    '13 %'
    """
    ends = percent(low), percent(high)
    return ends[1] if ends[0] == ends[1] else f"{ends[0].removesuffix(' %')} to {ends[1]}"


def places(where: Sequence[Where]) -> str:
    """Where most of the excess is, and whether it stands out from its surroundings."""
    channel, most = _largest((p.channel, p.share) for p in where)
    said = "Where: "
    if most >= ONE_CHANNEL:
        said += f"{percent(most)} of the excess is in channel {channel}; "
    shares = {frames: sum(p.share for p in where if p.frames == frames) for frames in FRAMES}
    total = sum(shares.values())
    parts = [f"{percent(share / total)} {FRAMES[f]}" for f, share in shares.items() if share >= SEEN]
    said += ", ".join(parts)
    kinds: dict[tuple[str, str], list[Where]] = {}
    for p in where:
        kinds.setdefault((_kind(p.region), p.frames), []).append(p)
    dense = [
        own
        for own in kinds.values()
        if sum(p.share for p in own) >= max(SPREAD * sum(p.share / p.times for p in own), SEEN)
    ]
    dense.sort(key=lambda own: -sum(p.share for p in own))
    if not dense:
        return f"{said}. No region stands out: it is spread over the picture."
    return f"{said}. It stands out at: {'; '.join(_place(own) for own in dense[:MOST_PLACES])}."


def _kind(region: str) -> str:
    """A region without the LED group that it is seen from."""
    return (
        "slopes of the imprint"
        if region.startswith("slope of the imprint")
        else re.sub(r"the \S+ LEDs", "the channel's own LEDs", region)
    )


def _place(own: Sequence[Where]) -> str:
    channel, most = _largest((p.channel, p.share) for p in own)
    share, area = sum(p.share for p in own), sum(p.area for p in own)
    only = len(own) == 1 or most >= ONE_CHANNEL * share
    named = f", channel {channel}" if only else ", all channels"
    region = next(p.region for p in own if p.channel == channel) if only else own[0].region
    shown = region if only and len({p.region for p in own if p.channel == channel}) == 1 else _kind(region)
    return (
        f"{shown} ({FRAMES[own[0].frames]}{named}), {percent(share)} of the excess on "
        f"{percent(area)} of the values{_sign(own)}"
    )


def _sign(own: Sequence[Where]) -> str:
    """Whether the measurement is brighter or darker there; nothing where it is both."""
    mean_z = sum(p.mean_z * p.area for p in own) / sum(p.area for p in own)
    if abs(mean_z) < EVEN_Z:
        return ""
    return f", measured {'brighter' if mean_z > 0 else 'darker'} than simulated"


def _largest(shares: Iterable[tuple[str, float]]) -> tuple[str, float]:
    """Name with the largest sum."""
    sums: dict[str, float] = {}
    for name, share in shares:
        sums[name] = sums.get(name, 0.0) + share
    return max(sums.items(), key=lambda item: item[1])


def _to_do(report: GapReport) -> list[str]:
    if report.verdict == "unexplained":
        return [
            "Nothing was added to the model. Look at the pictures of what is left; usual causes that the "
            f"catalogue does not hold are {OUTSIDE}."
        ]
    if report.barred:
        return ["Settle what the reserve is about, with other frames, before you rely on the name."]
    if report.verdict == "partial":
        return ["Look at what is left before you design with the updated model."]
    if report.verdict == "ambiguous":
        return [
            f"The updated model holds {' and '.join(effect.name for effect in report.effects)}. It predicts "
            "this sensor; for another design take the measurement below first, since the candidates differ "
            "there."
        ]
    if report.verdict == "at_floor":
        return [
            "Nothing was added to the model. Effects too small for these frames, or outside what they show, "
            "are not excluded."
        ]
    units = [effect.name for effect in report.effects if not effect.transferable]
    if units:
        return [f"{', '.join(units)}: of this unit, not of the design; another unit has its own."]
    return []


def limits(report: GapReport) -> tuple[str, ...]:
    """What a diagnosis by its frames cannot know."""
    seen = report.seen
    train, select, final = (len(seen.of(use)) for use in ("train", "select", "final"))
    if "blocks" in report.provenance:
        found = [*ONE]
    else:
        found = [
            f"All numbers come from one sensor: {count(train, 'press')} to fit, {select} to choose, {final} "
            "for the last figures."
        ]
    found += [
        "Only products are known: power of an LED group, reflectance of the membrane, gain and exposure are "
        "one number for each group, and are fitted in every comparison.",
        "Poses of the presses are fitted within their stated errors; what looks like a moved, turned or "
        "deeper press is taken for one.",
    ]
    if not seen.repeats:
        found.append("No frame was repeated: the noise floor is assumed, not measured.")
    if not seen.dark:
        found.append("No frame without light: a constant added to every picture may hide in other effects.")
    if not any(shot.gel_rotation_deg for shot in seen.shots):
        found.append(
            "The gel was never turned: uneven reflectance of the membrane and a fall-off of the lens "
            "look alike."
        )
    if not any((shot.lit > 0).sum() == 1 for shot in seen.shots if shot.press is None):
        found.append(
            "No LED group was photographed alone: mixing of colours, stray light and a constant look alike."
        )
    if report.effects:
        found.append(
            "Intervals hold small departures that no catalogue lists; large ones shift values by more."
        )
    return tuple(found)


def taken(removed: float) -> str:
    """Say what an effect does to a gap.

    Examples
    --------
    >>> taken(0.12), taken(-0.2)
    ('takes away 12 % of it', 'widens it by 20 %')
    """
    return f"takes away {percent(removed)} of it" if removed >= 0 else f"widens it by {percent(-removed)}"


def percent(share: float) -> str:
    """Write a share for people.

    Examples
    --------
    >>> percent(0.998), percent(0.5), percent(0.003), percent(-0.031)
    ('99.8 %', '50 %', '0.3 %', '-3 %')
    """
    fine = 0.99 < share < 1 or 0 < share < 0.0095
    return f"{100 * share:.1f} %" if fine else f"{100 * share:.0f} %"


def number(value: float) -> str:
    """Write a number with three digits, without a power of ten.

    Examples
    --------
    >>> number(1.2345), number(15321.0)
    ('1.23', '15300')
    """
    return f"{float(f'{value:.3g}'):.10g}"


def count(things: int, noun: str) -> str:
    """Write a number of things.

    Examples
    --------
    >>> count(1, "press"), count(2, "press"), count(3, "parameter")
    ('1 press', '2 presses', '3 parameters')
    """
    plural = f"{noun}es" if noun.endswith("s") else f"{noun}s"
    return f"{things} {noun if things == 1 else plural}"

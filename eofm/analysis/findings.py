"""What was found, and what to doubt, in plain sentences made from the summary."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Literal

from eofm.imaging.intensity import LINEAR

# Above these a finding is a doubt: share held by the regulariser, forward-backward error in px,
# share of the residual that is left, share of bubbles lost, motion as a part of the reach,
# distance in robust ranges.
HELD, ASTRAY, LEFT, LOST, NEAR = 0.25, 0.25, 0.8, 0.6, 0.7
# Error bars up to this, px, are drawn in pale colours: good looks good.
SHORT = 0.1
NAMES = ("lateral", "axial", "elevational")
# Which way components run.
WAYS = (("to the left", "to the right"), ("upwards", "downwards"), ("to the front", "to the back"))

Level = Literal["good", "note", "doubt"]


@dataclass(frozen=True)
class Finding:
    """A sentence, and what to do about it."""

    level: Level
    text: str
    advice: str = ""


@dataclass(frozen=True)
class Units:
    """Lengths in the unit that the results have: um where the size of a pixel was said, or px."""

    summary: dict[str, Any]

    @property
    def name(self) -> str:
        """The unit as it is written."""
        return "µm" if self.summary["pixel_size_from"] else "px"

    def factor(self, i: int | None = None) -> float:
        """Side of a pixel along component ``i``, or the mean of all, in this unit."""
        sides = self.summary["pixel_size_um"]
        if i is not None:
            return float(sides[i])
        product = 1.0
        for side in sides:
            product *= side
        return float(product ** (1 / len(sides)))

    def say(self, pixels: float, i: int | None = None) -> str:
        """A length with its unit, and in px where that is another."""
        said = f"{self.factor(i) * pixels:.3g} {self.name}"
        return said if self.name == "px" else f"{said} ({pixels:.3g} px)"


def verdict(summary: dict[str, Any]) -> str:
    """The worst verdict of the steps."""
    order = ("good", "doubtful", "failed")
    return max((step["verdict"] for step in summary["trust"]), key=order.index)


def found(summary: dict[str, Any]) -> list[str]:
    """What was found, a sentence each."""
    units = Units(summary)
    sentences = [*_motion(summary, units), _strain(summary)]
    stiffness = summary.get("stiffness")
    if stiffness and stiffness["modulus_range"]:
        low, high = stiffness["modulus_range"]
        sure = "" if stiffness["contrast_is_significant"] else ", which the images do not bear out"
        sentences.append(
            f"The stiffness is between {low:.2g} and {high:.2g} times that of the background{sure}."
        )
    return sentences


def doubts(summary: dict[str, Any]) -> list[Finding]:
    """What to doubt and what bears the result out, doubts first."""
    checks = (
        trusted,
        _left,
        _back,
        _held,
        _near,
        _bubbles,
        _defects,
        _printed,
        _lines,
        _dead,
        _unlike,
        _scale,
        _linear,
        _stiffness,
    )
    findings = [finding for check in checks for finding in check(summary)]
    order = ("doubt", "note", "good")
    return sorted(findings, key=lambda finding: order.index(finding.level))


def _motion(summary: dict[str, Any], units: Units) -> Iterator[str]:
    steps = summary["steps"]
    whole = "" if steps == 1 else f" from the first of {steps + 1} frames to the last"
    for i in range(len(summary["pixel_size_um"])):
        ends = sorted(summary[f"u{i + 1}_range_px"], key=abs, reverse=True)
        far, near = ends
        way = WAYS[i][far > 0]
        text = f"The sample moves{whole} by up to {units.say(abs(far), i)} {way}"
        # Where it goes both ways, both are said.
        if far * near < 0 and abs(near) > 0.05 * abs(far):
            text += f" and {units.say(abs(near), i)} {WAYS[i][near > 0]}"
        bars = summary.get("deviation_median_px")
        if bars:
            text += f"; half of the {NAMES[i]} error bars are shorter than {units.say(bars[i], i)}"
        yield text + "."


def _strain(summary: dict[str, Any]) -> str:
    axial = summary["strains"]["e22 axial"]
    ends = (-axial["high"], -axial["low"])
    word, other = "compressed", "stretched"
    if axial["mean"] > 0:
        ends, word, other = (axial["low"], axial["high"]), other, word
    least, most = (_percent(end) for end in ends)
    text = f"It is {word} along the depth by {abs(axial['mean']):.2%} in the mean"
    if least != most:
        text += f", locally by {least} to {most}"
    return text + (f" (negative: {other})." if ends[0] < 0 else ".")


def _percent(value: float) -> str:
    return f"{value + 0.0:.1%}"


def trusted(summary: dict[str, Any]) -> Iterator[Finding]:
    """What the verdict rests on, or why it is not good."""
    several = len(summary["trust"]) > 1
    for k, step in enumerate(summary["trust"], 1):
        of = f"Step {k}: " if several else ""
        if step["verdict"] == "good":
            text = f"{step['agreeing']:.0%} of the image match the other one after the motion."
            yield Finding("good", of + text)
        for reason in step["reasons"]:
            text, _, advice = reason.partition("; ")
            yield Finding("doubt", of + _sentence(text), _sentence(advice))


def _left(summary: dict[str, Any]) -> Iterator[Finding]:
    after, before = summary["residual_rms"], summary["residual_rms_without_motion"]
    text = (
        f"The difference of the images is {before:.2g} of their range without the motion and"
        f" {after:.2g} after it."
    )
    if before > 0 and after > LEFT * before:
        yield Finding(
            "doubt",
            text,
            "Most of it is no motion: average frames against noise, press in smaller steps, or"
            " check that both show the same place.",
        )
    else:
        yield Finding("good", text)


def _back(summary: dict[str, Any]) -> Iterator[Finding]:
    error, units = summary["forward_backward_error_median_px"], Units(summary)
    text = f"There and back again ends {units.say(error)} from the start in the median."
    if error <= ASTRAY:
        yield Finding("good", text)
    # A reason of the verdict says it already where it is so.
    elif not any("way back" in r for step in summary["trust"] for r in step["reasons"]):
        yield Finding("doubt", text, "Look where: the map shows what not to use.")


def _held(summary: dict[str, Any]) -> Iterator[Finding]:
    share = summary["share_held_by_regulariser"]
    text = f"At {share:.0%} of the pixels the images say next to nothing; they are filled in."
    if share > HELD:
        yield Finding(
            "doubt",
            text,
            "Read no detail where the map says so: mask it, state what is known of the edges or a"
            " background, or take images with more structure.",
        )
    elif share >= 0.005:
        yield Finding("note", text)
    else:
        yield Finding("good", "The images decide everywhere.")


def _near(summary: dict[str, Any]) -> Iterator[Finding]:
    units = Units(summary)
    steps = summary["steps"]
    for i, (moved, reach) in enumerate(
        zip(summary["largest_motion_px"], summary["reach_px"], strict=True)
    ):
        if moved / steps > NEAR * reach:
            yield Finding(
                "doubt",
                f"The {NAMES[i]} motion of {units.say(moved, i)} is near the limit of what is"
                f" searched for, {units.say(reach, i)} in a step.",
                "Press in smaller steps, use more scales, or state the edges and a background.",
            )


def _bubbles(summary: dict[str, Any]) -> Iterator[Finding]:
    followed, there = sum(summary["bubbles"]), sum(summary["bubbles_found"])
    lost = 1 - followed / max(there, 1)
    text = f"{followed} of {there} bubbles were followed."
    if not followed:
        yield Finding(
            "note",
            f"None of {there} bubbles was followed; the field rests on the images alone.",
            "A lower quality or a larger gate keeps more, and so do averages of frames.",
        )
    elif lost > LOST:
        yield Finding(
            "note",
            text,
            "Speckle that changes is lost; a lower quality or a larger gate keeps more of it.",
        )
    else:
        yield Finding("good", text)


def _defects(summary: dict[str, Any]) -> Iterator[Finding]:
    shares = summary["defect_share"]
    totals = [sum(kinds.values()) for kinds in shares]
    if max(totals) > 0:
        frame = totals.index(max(totals))
        kinds = ", ".join(f"{kind} ({share:.2%})" for kind, share in shares[frame].items())
        yield Finding(
            "note",
            f"Left out of frame {frame + 1}: {kinds}.",
            "A lower gain of the detector spares highlights and saturated lines; pixels that stand"
            " alone are hot, dead, or noise.",
        )


def _printed(summary: dict[str, Any]) -> Iterator[Finding]:
    if summary["printed_share"] > 0:
        yield Finding(
            "note",
            f"Frames or labels, alike in both images, cover {summary['printed_share']:.1%}.",
            "They are left out, and what lies below them is not seen: crop frames, and export"
            " images without labels.",
        )


def _lines(summary: dict[str, Any]) -> Iterator[Finding]:
    if lines := summary["lines_taken_off"]:
        yield Finding(
            "note",
            f"Lines of a detector, the same {' and '.join(lines)} of both images, or some that"
            " flicker, were taken off.",
            "The mean of many frames without a sample, taken off all frames, removes them better.",
        )


def _dead(summary: dict[str, Any]) -> Iterator[Finding]:
    if summary["dead_share"] > 0:
        yield Finding("note", f"The mask leaves out {summary['dead_share']:.0%} of the image.")


def _unlike(summary: dict[str, Any]) -> Iterator[Finding]:
    share = max(step["unlike"] for step in summary["trust"])
    if share >= 0.005:
        yield Finding(
            "note",
            f"{share:.1%} of the image show what the other one does not; they were left out, and"
            " the motion there is filled in.",
            "Where both show the same sample, it may move otherwise than was found: see the map of"
            " trust, and press in smaller steps.",
        )


def _scale(summary: dict[str, Any]) -> Iterator[Finding]:
    if Units(summary).name == "px":
        yield Finding(
            "note",
            "The size of a pixel was not said, so lengths are in px.",
            "Neither the files nor you say it; --lateral-size and --axial-size do, in um. Strains"
            " are right if pixels are square.",
        )


def _linear(summary: dict[str, Any]) -> Iterator[Finding]:
    if summary["looks_linear"]:
        yield Finding(
            "note",
            f"The first image {LINEAR}.",
            "Try the logarithm, --intensity log, and compare: it helps most where the image fades"
            " with depth.",
        )


# What to do where the sample that was identified does not fit.
UNFIT = (
    "check the Poisson ratio, the plane, and the motion of edges that was stated, which a sample"
    " that slides does not have; noise, and speckle that changes, hide a modulus as well"
)


def _stiffness(summary: dict[str, Any]) -> Iterator[Finding]:
    stiffness = summary.get("stiffness") or {}
    if stiffness.get("refused"):
        text, _, advice = stiffness["refused"].partition("; ")
        yield Finding("doubt", f"No stiffness: {text}.", _sentence(advice or UNFIT))
    elif stiffness and abs(stiffness["edge_motion_factor"] - 1) > 1e-6:
        yield Finding(
            "doubt",
            f"The images show {stiffness['edge_motion_factor']:.0%} of the motion that was stated"
            " of the edges; theirs is taken.",
            "Check the motion that was stated, and its unit.",
        )


def _sentence(text: str) -> str:
    return text and text[0].upper() + text[1:] + ("" if text.endswith(".") else ".")

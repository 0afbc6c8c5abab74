"""Sentences say what the numbers say, and only what is wrong is a doubt."""

import copy

import pytest

from eofm.analysis.findings import Units, doubts, found, verdict

TRUST = {"verdict": "good", "reasons": [], "agreeing": 0.97, "contradicting": 0.0, "unlike": 0.0}
STRAIN = {"mean": -0.03, "low": -0.05, "high": 0.01}
GOOD = {
    "pixel_size_um": [4.0, 2.0],
    "pixel_size_from": "known",
    "steps": 1,
    "bubbles": [90],
    "bubbles_found": [100],
    "u1_range_px": [-1.0, 2.0],
    "u2_range_px": [-3.0, 0.01],
    "largest_motion_px": [2.0, 3.0],
    "reach_px": [45.0, 25.0],
    "deviation_median_px": [0.01, 0.02],
    "dead_share": 0.0,
    "forward_backward_error_median_px": 0.003,
    "trust": [TRUST],
    "strains": {"e22 axial": STRAIN},
    "residual_rms": 0.01,
    "residual_rms_without_motion": 0.09,
    "share_held_by_regulariser": 0.0,
    "looks_linear": False,
    "defect_share": [{}, {}],
    "printed_share": 0.0,
    "lines_taken_off": [],
}


def changed(**values):
    return copy.deepcopy(GOOD) | values


def said(summary, level):
    return [f"{f.text} {f.advice}" for f in doubts(summary) if f.level == level]


def test_where_all_is_well_there_is_no_doubt():
    assert verdict(GOOD) == "good"
    assert {finding.level for finding in doubts(GOOD)} == {"good"}


def test_motion_is_said_with_its_way_and_unit():
    lateral, axial, strain = found(GOOD)
    assert "by up to 8 µm (2 px) to the right and 4 µm (1 px) to the left" in lateral
    assert "0.04 µm (0.01 px)" in lateral
    # One way alone where the other is next to nothing.
    assert "by up to 6 µm (3 px) upwards;" in axial
    assert "downwards" not in axial
    assert "compressed along the depth by 3.00% in the mean" in strain
    assert "-1.0% to 5.0%" in strain


def test_strain_is_said_along_the_way_that_it_goes():
    for mean, low, high, text in (
        (-0.03, -0.05, -0.01, "compressed along the depth by 3.00% in the mean, locally by 1.0%"),
        (
            0.03,
            0.01,
            0.05,
            "stretched along the depth by 3.00% in the mean, locally by 1.0% to 5.0%.",
        ),
        (0.03, -0.01, 0.05, "locally by -1.0% to 5.0% (negative: compressed)."),
        (-0.03, -0.03, -0.03, "compressed along the depth by 3.00% in the mean."),
    ):
        strain = {"e22 axial": {"mean": mean, "low": low, "high": high}}
        assert text in found(changed(strains=strain))[-1]


def test_lengths_are_in_px_where_no_pixel_size_was_said():
    summary = changed(pixel_size_from=None, pixel_size_um=[1.0, 1.0])
    assert Units(summary).say(2.5, 0) == "2.5 px"
    assert "µm" not in " ".join(found(summary))
    assert "--lateral-size" in said(summary, "note")[0]


def test_a_sequence_says_that_it_is_the_sum():
    assert "from the first of 4 frames to the last" in found(changed(steps=3))[0]


@pytest.mark.parametrize(
    ("values", "level", "text", "advice"),
    [
        ({"share_held_by_regulariser": 0.4}, "doubt", "At 40% of the pixels", "mask it"),
        ({"share_held_by_regulariser": 0.1}, "note", "At 10% of the pixels", ""),
        ({"forward_backward_error_median_px": 0.5}, "doubt", "There and back", "Look where"),
        ({"residual_rms": 0.085}, "doubt", "0.09 of their range", "average frames"),
        ({"bubbles": [20]}, "note", "20 of 100 bubbles", "lower quality"),
        ({"largest_motion_px": [2.0, 24.0]}, "doubt", "near the limit", "smaller steps"),
        (
            {
                "defect_share": [
                    {"single pixels": 0.01},
                    {"highlights": 0.02, "single pixels": 0.001},
                ]
            },
            "note",
            "frame 2: highlights (2.00%), single pixels (0.10%)",
            "lower gain",
        ),
        ({"printed_share": 0.13}, "note", "cover 13.0%", "crop frames"),
        ({"lines_taken_off": ["rows", "columns"]}, "note", "same rows and columns", "mean of many"),
        ({"dead_share": 0.2}, "note", "The mask leaves out 20%", ""),
        ({"looks_linear": True}, "note", "looks like linear intensity", "--intensity log"),
    ],
)
def test_what_is_wrong_is_said_with_what_to_do(values, level, text, advice):
    told = said(changed(**values), level)
    assert len(told) == 1
    assert text in told[0]
    assert advice in told[0]


def test_reasons_of_the_verdict_come_first_with_their_advice():
    reason = "top: the images contradict the motion that was stated; check it"
    bad = TRUST | {"verdict": "doubtful", "reasons": [reason]}
    summary = changed(trust=[TRUST, bad], steps=2)
    first = doubts(summary)[0]
    assert verdict(summary) == "doubtful"
    assert first.level == "doubt"
    assert first.text == "Step 2: Top: the images contradict the motion that was stated."
    assert first.advice == "Check it."


def test_the_limit_is_that_of_a_step():
    assert not said(changed(largest_motion_px=[2.0, 24.0], steps=3), "doubt")


def test_a_stiffness_that_was_refused_is_a_doubt():
    stiffness = {"refused": "held-out bubbles speak against it; state the edges"}
    stiffness |= {
        "modulus_range": None,
        "edge_motion_factor": 1.0,
        "contrast_is_significant": False,
    }
    summary = changed(stiffness=stiffness)
    assert "No stiffness: held-out bubbles" in said(summary, "doubt")[0]
    found_one = stiffness | {"refused": None, "modulus_range": [0.9, 4.0]}
    assert "between 0.9 and 4 times" in found(changed(stiffness=found_one))[-1]
    assert "do not bear out" in found(changed(stiffness=found_one))[-1]


def test_what_was_left_out_of_one_image_is_noted():
    summary = changed(trust=[TRUST, TRUST | {"unlike": 0.05}])
    assert [t for t in said(summary, "note") if "5.0% of the image show what the other" in t]
    assert not [t for t in said(changed(), "note") if "does not" in t]

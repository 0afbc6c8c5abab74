import json
import runpy

import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

from eofm.app.config import Config, load
from eofm.errors import InputError
from eofm.settings import Estimation, Forward, Phantom, Sample


@pytest.fixture(scope="module")
def folder(request):
    return request.config.rootpath / "config"


@pytest.fixture(scope="module")
def describe(request):
    return runpy.run_path(request.config.rootpath / "workflow/scripts/describe_config.py")


def test_schema_and_tables_have_not_drifted_from_the_models(folder, describe):
    advice = "run python workflow/scripts/describe_config.py"
    assert (folder / "config.schema.json").read_text() == describe["schema"](), advice
    text = (folder / "README.md").read_text()
    assert text == describe["readme"](text), advice


def test_the_configuration_states_only_what_it_chooses(folder):
    """Without any one of its values the experiment would be another one, or none."""
    stated = yaml.safe_load((folder / "config.yaml").read_text())
    experiment = load(folder / "config.yaml")

    def cut(values, path=()):
        for key in values:
            rest = {k: v for k, v in values.items() if k != key}
            yield (*path, key), rest
            if isinstance(values[key], dict):
                for where, inner in cut(values[key], (*path, key)):
                    yield where, values | {key: inner}

    cuts = dict(cut(stated))
    assert ("sample", "height") in cuts
    for where, values in cuts.items():
        try:
            changed = Config.parse(values, "cut") != experiment
        except InputError:
            changed = True
        assert changed, f"{'.'.join(where)} is the default"


def test_a_sample_states_its_size():
    for values in ({}, {"height": 108}, {"width": 180}):
        with pytest.raises(InputError, match="field required"):
            Sample.parse(values, "sample")


def test_the_paper_s_parameters(folder):
    config = load(folder / "config.yaml")
    assert list(config.tests) == ["1", "2", "3", "4", "5"]
    rows = {name: config.variant(name) for name in config.tests}
    assert {row.alpha for row in rows.values()} == {0.8}
    assert {row.sigma for row in rows.values()} == {5.0}
    assert [row.beta for row in rows.values()] == [0.5, 0, 0, 0.5, 0.5]
    assert [row.scales for row in rows.values()] == [4, 1, 4, 1, 4]
    assert [test.background for test in config.tests.values()] == [False, True, True, True, True]
    assert [row.zero_edges for row in rows.values()] == [()] + 4 * [("top", "bottom")]
    assert config.phantom.count == 200


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"estimaton": {}}, "unknown key estimaton; did you mean estimation"),
        ({"estimation": {"alfa": 1}}, "unknown key estimation.alfa; did you mean alpha?"),
        ({"sample": {"qqq": 1}}, "unknown key sample.qqq"),
        (
            {"estimation": {"alpha": 0}},
            r"estimation.alpha: input should be greater than or equal to 0.000001 \(got 0\)",
        ),
        ({"estimation": {"alpha": "much"}}, "estimation.alpha: .*number.*'much'"),
        ({"estimation": {"alpha": float("nan")}}, "estimation.alpha: .*finite"),
        ({"estimation": {"zero_edges": ["top", "bottem"]}}, "estimation.zero_edges.1: .*'bottem'"),
        ({"estimation": {"limits": [1, 1]}}, "limits: wants low < high"),
        ({"sample": {"poisson_ratio": 0.5}}, "sample.poisson_ratio: .*less than 0.5"),
        ({"sample": {"height": 40, "compression": 30}}, "compression: 30 px is half of"),
        ({"sample": {"inclusions": [{"x1": 1}]}}, "sample.inclusions.0.x2: field required"),
        ({"phantom": {"sigma": [2, 1]}}, "sigma: wants 0 < low <= high"),
        (
            {"tests": {"9": {"changes": {"alpha": -1}}}},
            "tests.9.changes: alpha: .*greater than or equal to",
        ),
        ({"tests": {"6": {}}}, "'6' cannot be a test's name"),
        ({"estimation": {"method": "paper", "alpha": None}}, "alpha: wants a value with"),
        ({"preset": {"method": "papers"}}, "preset.method: .*'preset' or 'paper'"),
        ({"figures": {"pixel_size": [0, 5]}}, "figures.pixel_size.0: .*greater than 0"),
        ({"sample": 5}, "sample: .*dictionary"),
    ],
)
def test_wrong_values_are_named_in_one_line(values, message):
    if isinstance(values.get("sample", {}), dict):
        values = values | {"sample": {"height": 108, "width": 180} | values.get("sample", {})}
    with pytest.raises(InputError, match=message) as caught:
        Config.parse(values, "configuration")
    assert "\n" not in str(caught.value)


@given(
    st.dictionaries(
        st.sampled_from([*Estimation.model_fields, "alhpa"]),
        st.one_of(
            st.none(), st.floats(), st.integers(), st.text(max_size=5), st.lists(st.floats())
        ),
    )
)
def test_any_values_give_settings_or_one_line(values):
    try:
        settings = Estimation.parse(values, "estimation")
    except InputError as error:
        assert "\n" not in str(error).strip()  # noqa: PT017
    else:
        assert Estimation.parse(json.loads(settings.model_dump_json()), "again") == settings


def test_numbers_may_come_as_strings_from_the_command_line():
    assert Forward.parse({"true_cell": "3.5"}, "forward").true_cell == 3.5
    assert Phantom.parse({"sigma": ["1", "2"]}, "phantom").sigma == (1, 2)


@pytest.mark.parametrize("text", ["", "[1, 2", "- 1", "\0"])
def test_a_broken_file_is_named(tmp_path, text):
    path = tmp_path / "broken.yaml"
    path.write_text(text)
    with pytest.raises(InputError, match=r"broken\.yaml"):
        load(path)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(InputError, match=r"nowhere\.yaml"):
        load(tmp_path / "nowhere.yaml")


def test_the_method_says_whose_defaults_hold():
    preset, paper = Estimation(), Estimation(method="paper")
    assert (preset.smoothness, preset.alpha, preset.warps) == ("bending", None, 2)
    assert (paper.smoothness, paper.alpha, paper.warps) == ("gradient", 0.8, 1)
    assert Estimation.parse(paper.model_dump(), "again") == paper

"""What a study varies, case by case, and what the steps of the experiment make of a case.

A table ``config/studies/NAME.yaml`` has blocks of axes, all combinations of whose values are
cases. An axis is a key of the configuration with its values, ``{key: ..., values: [...]}`` under a
name of its own, or labels with what each changes.
"""

import json
from collections.abc import Iterable
from functools import cache
from itertools import islice, product
from typing import Any, Literal

import numpy as np
import pandas as pd
from numpy.typing import NDArray
from pydantic import Field
from search_phantom import BOUNDS, candidate, parameters

import eofm
from eofm.app.config import Config
from eofm.settings import Section

Array = NDArray[np.float64]
Changes = dict[str, Any]

ERRORS = ["e_rel", "e_rel_u1", "e_rel_u2", "max_error_u1", "max_error_u2"]
# How far a perturbed phantom goes, as a part of the bounds of the search.
PERTURBATION = 0.1


class Given(Section):
    """What a case changes beside the configuration; keys ``given.KEY`` of a table."""

    bubbles: Literal["tracked", "exact"] = "tracked"
    tracking_noise: float = Field(0.0, description="added to the bubbles' motions, px")
    wrong: float = Field(0.0, description="part of the bubbles that are matched wrongly")
    decorrelation: float = Field(0.0, description="part of the bubbles that another replaces")
    perturbed: int = Field(0, description="number of a phantom whose parameters are disturbed")
    stiffness: float | None = Field(None, description="of the inclusion")
    radius: float | None = Field(None, description="of the inclusion, as a part of the height")
    poisson_ratio: float | None = Field(None, description="that is believed")
    edge: float = Field(1.0, description="factor of the bottom's motion that is believed")


def cases(
    blocks: Iterable[dict[str, Any]], values: int | None = None, most: int | None = None
) -> list[tuple[Changes, Changes]]:
    """Labels and changes of the first cases, with some ``values`` along each axis."""
    found = []
    for block in blocks:
        fixed = {name: value for name, value in block.items() if name not in ("axes", "changes")}
        axes = [list(islice(_values(*axis), values)) for axis in block["axes"].items()]
        for chosen in product(*axes):
            labels, changes = dict(fixed), dict(block.get("changes", {}))
            for label, change in chosen:
                labels |= label
                changes |= change
            found.append((labels, changes))
    return found[:most]


def _values(name: str, values: Any) -> list[tuple[Changes, Changes]]:
    column = name.rpartition(".")[2]
    if isinstance(values, dict) and set(values) == {"key", "values"}:
        name, values = values["key"], values["values"]
    if isinstance(values, dict):
        return [({column: label}, change) for label, change in values.items()]
    return [({column: value}, {name: value}) for value in values]


def run(config: Config, changes: Changes, methods: list[str]) -> list[dict[str, Any]]:
    """Errors of methods, a row each: tests, ``5b``, ``6`` or ``background``."""
    config, given = changed(config, changes)
    believed = config.sample.changed(compression=given.edge * config.sample.compression)
    if given.poisson_ratio is not None:
        believed = believed.changed(poisson_ratio=given.poisson_ratio)
    truth, u_bg = (
        _field("true_field", config.sample, config),
        _field("background_field", believed, config),
    )
    I1, I2, table = images(truth, config.phantom, given.decorrelation)
    rows = []
    for method in methods:
        row: dict[str, Any] = {"method": method}
        try:
            bubbles = _bubbles(I1, I2, table, u_bg, config, given)
            row["bubbles"] = len(bubbles)
            u = estimate(method, config, believed, I1, I2, bubbles, u_bg)
            row |= eofm.relative_errors(u, truth)
        except eofm.InputError as error:
            row["refused"] = str(error)
        rows.append(row)
    return rows


def changed(config: Config, changes: Changes) -> tuple[Config, Given]:
    """The configuration of a case, and what else it changes."""
    given = Given.parse({k[6:]: v for k, v in changes.items() if k.startswith("given.")}, "given")
    if given.perturbed:
        low, high = np.array(list(BOUNDS.values())).T
        away = np.random.default_rng([2026, given.perturbed]).uniform(-1, 1, len(low))
        values = parameters(config) + PERTURBATION * (high - low) * away
        config = candidate(config, np.maximum(values, 0))
        config = config.changed(phantom=config.phantom.changed(seed=given.perturbed))
    values = config.model_dump()
    for key, value in changes.items():
        section, _, name = key.partition(".")
        if section != "given":
            values[section][name] = value
    disc = values["sample"]["inclusions"][0]
    if given.stiffness is not None:
        disc["stiffness"] = given.stiffness
    if given.radius is not None:
        disc["radius"] = given.radius * values["sample"]["height"]
        disc["x2"] = min(disc["x2"], values["sample"]["height"] - 2 - disc["radius"])
    return Config.parse(values, "study"), given


def _field(name: str, sample: eofm.Sample, config: Config) -> Array:
    return _solved(name, sample.model_dump_json(), config.forward.model_dump_json())


@cache
def _solved(name: str, sample: str, forward: str) -> Array:
    return getattr(eofm, name)(
        eofm.Sample(**json.loads(sample)), eofm.Forward(**json.loads(forward))
    )


def images(
    u: Array, phantom: eofm.Phantom, decorrelation: float
) -> tuple[Array, Array, pd.DataFrame]:
    """Images and bubbles, some of which are there before or after compression alone."""
    lost = round(decorrelation * phantom.count)
    I1, I2, bubbles = eofm.make_phantom(u, phantom.changed(count=phantom.count - lost))
    if lost:
        alone = (
            phantom.changed(count=lost, base=0, noise=0, seed=1000 * phantom.seed + k)
            for k in (1, 2)
        )
        only1, only2 = (eofm.make_phantom(u, settings) for settings in alone)
        I1, I2 = I1 + only1[0], I2 + only2[1]
    return I1, I2, bubbles


def _bubbles(
    I1: Array, I2: Array, exact: pd.DataFrame, u_bg: Array, config: Config, given: Given
) -> pd.DataFrame:
    """Tracked or exact bubbles, with what is wrong with them."""
    if given.bubbles == "exact":
        bubbles = exact
    else:
        bubbles = eofm.track(I1, I2, config.tracking, prediction=u_bg)
    rng = np.random.default_rng([config.phantom.seed, 4])
    motion = bubbles[["u1", "u2"]] + given.tracking_noise * rng.standard_normal((len(bubbles), 2))
    # A wrong match lies anywhere within the gate about the right one.
    wrong = rng.permutation(len(bubbles)) < round(given.wrong * len(bubbles))
    radius = config.tracking.gate * np.sqrt(rng.uniform(size=len(bubbles)))
    angle = rng.uniform(0, 2 * np.pi, len(bubbles))
    away = np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)
    motion = motion + wrong[:, None] * away
    return bubbles.assign(u1=motion.u1, u2=motion.u2)


def estimate(
    method: str,
    config: Config,
    sample: eofm.Sample,
    I1: Array,
    I2: Array,
    bubbles: pd.DataFrame,
    u_bg: Array,
) -> Array:
    """The displacement that a method finds, given what is believed of the sample."""
    known = eofm.Known(bubbles=bubbles, background=u_bg)
    if method == "background":
        return u_bg
    if method == "5b":
        return eofm.estimate_displacement(I1, I2, config.preset, known).u
    if method == "6":
        # The inclusions are what is sought.
        sample = sample.changed(inclusions=())
        known = eofm.Known(bubbles=bubbles)
        return eofm.identify_stiffness(
            I1, I2, sample, config.identification, config.preset, known=known
        ).estimate.u
    if not config.tests[method].background:
        known = eofm.Known(bubbles=bubbles)
    return eofm.estimate_displacement(I1, I2, config.variant(method), known).u

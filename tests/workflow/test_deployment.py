"""Environments, containers, and other workflows that have ours as a module."""

import os
import re
import shlex
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest
import yaml
from snakemake.settings.types import DeploymentMethod

from eofm.io import read_field

sys.path.insert(0, str(Path(__file__).parents[2] / "workflow/scripts"))
from deploy import prefix

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
INSTRUCTIONS = ("FROM", "WORKDIR", "COPY", "RUN", "ENV", "CMD")


def names(requirements):
    return {re.match(r"[\w-]+", text)[0].lower() for text in requirements}


def instructions():
    """Instructions of the Containerfile, each with its words."""
    text = re.sub(r"\\\n\s*", "", (ROOT / "Containerfile").read_text())
    lines = [line for line in text.splitlines() if line and line[0] != "#"]
    return [tuple(line.split(maxsplit=1)) for line in lines]


def test_the_environment_of_rules_has_the_versions_that_make_installs():
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    pins = {line.lower().replace("_", "-") for line in lines if "==" in line}
    *_, pip = yaml.safe_load((ROOT / "workflow/envs/eofm.yaml").read_text())["dependencies"]
    assert set(pip["pip"]) <= pins
    wanted = names(PROJECT["dependencies"] + PROJECT["optional-dependencies"]["workflow"])
    assert names(pip["pip"]) == wanted - {"snakemake"}


def test_every_rule_that_runs_something_names_the_environment():
    for path in (ROOT / "workflow/rules").glob("*.smk"):
        text = path.read_text()
        runs = re.findall(r"^ +(?:shell|script):$", text, flags=re.MULTILINE)
        assert text.count('conda:\n        "../envs/eofm.yaml"') + text.count(
            'conda:\n            "../envs/eofm.yaml"'
        ) == len(runs), path


def test_the_containerfile_builds_from_what_is_there():
    """No engine runs here: its copies exist, and its commands are those of the Makefile."""
    found = instructions()
    assert {name for name, _ in found} == set(INSTRUCTIONS)
    assert found[0][0] == "FROM"
    copied = set()
    for sources in (words.split()[:-1] for name, words in found if name == "COPY"):
        assert all((ROOT / source).exists() for source in sources)
        copied |= set(sources)
    # What pip needs to build the package, and Snakemake to run it.
    assert {"pyproject.toml", PROJECT["readme"], *PROJECT["license-files"], "eofm"} <= copied
    assert {"constraints.txt", "Snakefile", "config", "workflow", "profiles"} <= copied
    install, compilation = (words for name, words in found if name == "RUN")
    assert "--constraint constraints.txt '.[slurm]'" in install
    makefile = re.sub(r"\\\n\s*", "", (ROOT / "Makefile").read_text())
    assert shlex.split(compilation)[-1] in makefile


def test_the_catalog_knows_how_the_workflow_is_deployed():
    usage = yaml.safe_load((ROOT / ".snakemake-workflow-catalog.yml").read_text())["usage"]
    assert usage["software-stack-deployment"]["conda"] is True
    assert usage["report"] is True


@pytest.mark.parametrize("deployed", [(), (DeploymentMethod.CONDA,)])
def test_rules_run_the_package_of_the_checkout(deployed, tmp_path):
    """In an environment of its own, Python is that environment's and the package ours."""
    (tmp_path / "python").write_text(f'#!/bin/sh\nexec {sys.executable} "$@"\n')
    (tmp_path / "python").chmod(0o755)
    path = os.environ["PATH"] if not deployed else f"{tmp_path}:/usr/bin:/bin"
    done = subprocess.run(
        ["bash", "-c", prefix(ROOT, deployed) + "type -t eofm; eofm --version"],
        env=os.environ | {"PATH": path},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    kind, version = done.stdout.splitlines()
    assert kind == ("function" if deployed else "file")
    assert version == f"eofm {PROJECT['version']}"


@pytest.mark.slow
def test_another_workflow_has_ours_as_a_module(tmp_path):
    (tmp_path / "Snakefile").write_text(
        f"""
configfile: "mine.yaml"

module eofm:
    snakefile: "{ROOT}/Snakefile"
    config: config["eofm"]

use rule * from eofm as eofm_*

rule mine:
    input: rules.eofm_background_field.output
    output: "copy.tif"
    shell: "cp {{input}} {{output}}"
"""
    )
    settings = yaml.safe_load((ROOT / "config/config.yaml").read_text())
    settings |= yaml.safe_load((ROOT / "tests/small.yaml").read_text())
    (tmp_path / "samples.tsv").write_text("sample\treference\tdeformed\n")
    settings["samples"] = "samples.tsv"
    (tmp_path / "mine.yaml").write_text(yaml.safe_dump({"eofm": settings}))
    command = [sys.executable, "-m", "snakemake", "--cores", "1", "mine"]
    done = subprocess.run(
        command,
        cwd=tmp_path,
        env=os.environ | {"PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    assert "eofm_background_field" in done.stderr
    assert read_field(tmp_path / "copy.tif").shape == (2, 45, 70)

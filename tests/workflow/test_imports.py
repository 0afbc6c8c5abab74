"""Every rule declares the files that its script or step imports."""

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SCRIPTS = ROOT / "workflow/scripts"
sys.path.insert(0, str(SCRIPTS))
from imports import Sources  # noqa: E402

SOURCES = Sources(ROOT / "eofm")
RULES = {
    name: text
    for path in sorted((ROOT / "workflow/rules").glob("*.smk"))
    for name, text in re.findall(r"(?ms)^rule (\w+):\n(.*?)(?=^\S|\Z)", path.read_text())
}
# What a rule runs: the name of a script, or of a step of the command, which a script may run.
RUN = {
    name: (step or found).group(1)
    for name, text in RULES.items()
    if (found := re.search(r'"(?:\.\./scripts/|eofm )([\w.-]+)', text))
    for step in [re.search(r'words=lambda wildcards: \[\s*"([\w-]+)"', text)]
}
# Does nothing but the imports of scripts and steps, and says which files of ours came with them.
IMPORT = """
import ast, importlib, json, sys
from pathlib import Path

root, names = Path(sys.argv[1]), sys.argv[2:]
scripts = root / "workflow/scripts"
sys.path.insert(0, str(scripts))
found = {}
for name in names:
    for module in list(sys.modules):
        path = getattr(sys.modules[module], "__file__", None) or ""
        if path.startswith((str(root / "eofm"), str(scripts))):
            del sys.modules[module]
    space = {"__name__": "script"}
    if name.endswith(".py"):
        tree = ast.parse((scripts / name).read_text())
    else:
        word = "def " + name.replace("-", "_") + "("
        home = next(p for p in root.glob("eofm/app/**/*.py") if "\\n" + word in p.read_text())
        module = ".".join(home.relative_to(root).with_suffix("").parts)
        importlib.import_module(module)
        functions = ast.parse(home.read_text()).body
        tree = next(f for f in functions if ast.unparse(f).startswith((word, "@")) and
                    getattr(f, "name", "") == name.replace("-", "_"))
    for node in ast.walk(tree):
        if isinstance(node, ast.Import | ast.ImportFrom):
            exec(ast.unparse(node), space)
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and ast.unparse(node.value) == "eofm":
            getattr(space["eofm"], node.attr)
    files = [getattr(module, "__file__", None) or "" for module in sys.modules.values()]
    found[name] = sorted(f for f in files if f.startswith((str(root / "eofm"), str(scripts))))
print(json.dumps(found))
"""


@pytest.fixture(scope="module")
def imported():
    """Files of ours that Python has read after the imports of each script or step."""
    names = sorted(set(RUN.values()))
    words = [sys.executable, "-c", IMPORT, str(ROOT), *names]
    result = subprocess.run(words, capture_output=True, text=True, cwd=ROOT)
    assert result.returncode == 0, result.stderr
    return json.loads(result.stdout)


def test_there_are_rules_with_scripts_and_with_steps():
    assert {"table1", "figures", "track", "estimate", "stiffness"} <= RUN.keys()


@pytest.mark.parametrize("rule", RUN)
def test_a_rule_declares_the_code_of_what_it_runs(rule):
    assert f'code=code("{RUN[rule]}")' in RULES[rule]


@pytest.mark.parametrize("name", sorted(set(RUN.values())))
def test_no_import_is_undeclared(imported, name):
    of = SOURCES.of_script if name.endswith(".py") else SOURCES.of_step
    assert set(imported[name]) <= set(map(str, of(name)))


@pytest.fixture
def sources(tmp_path):
    """A package with two steps, a lazy name, and two scripts."""
    files = {
        "eofm/__init__.py": "",
        "eofm/__init__.pyi": "from .deep.work import work as work",
        "eofm/grid.py": "import typing\nif typing.TYPE_CHECKING:\n    from eofm import plot",
        "eofm/plot.py": "import numpy",
        "eofm/deep/__init__.py": "",
        "eofm/deep/work.py": "from ..grid import Grid\nfrom . import tool",
        "eofm/deep/tool.py": "",
        "eofm/app/__init__.py": "",
        "eofm/app/steps.py": "from eofm.deep import tool\n"
        "def go_on():\n    return _help()\n"
        "def draw():\n    from eofm.plot import figure\n"
        "def _help():\n    from eofm.grid import Grid\n",
        "scripts/table.py": "import side\nimport eofm\nprint(eofm.work())",
        "scripts/side.py": "from eofm.plot import figure",
    }
    for name, text in files.items():
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
    return Sources(tmp_path / "eofm", tmp_path / "scripts")


def names(files, sources):
    return {str(path.relative_to(sources.package.parent)) for path in files} - {
        f"eofm/{folder}__init__.py" for folder in ("", "app/", "deep/")
    }


def test_a_step_counts_what_its_own_function_imports(sources):
    assert names(sources.of_step("go-on"), sources) == {
        *("eofm/app/steps.py", "eofm/deep/tool.py", "eofm/grid.py")
    }
    assert "eofm/plot.py" in names(sources.of_step("draw"), sources)


@pytest.mark.parametrize("step", ["forward", "background", "phantom"])
def test_what_makes_samples_does_not_depend_on_how_they_are_estimated(step):
    files = names(SOURCES.of_step(step), SOURCES)
    estimates = ("eofm/flow/", "eofm/analysis/", "eofm/identification/", "eofm/imaging/bubbles.py")
    assert not [name for name in files if name.startswith(estimates)]


def test_a_script_counts_its_siblings_and_lazy_names(sources):
    assert names(sources.of_script("table.py"), sources) == {
        *("scripts/side.py", "eofm/plot.py"),
        *("eofm/deep/work.py", "eofm/deep/tool.py", "eofm/grid.py"),
    }


@pytest.mark.parametrize(("of", "name"), [("of_step", "estimat"), ("of_script", "table2.py")])
def test_what_is_not_there_is_an_error(sources, of, name):
    with pytest.raises(LookupError, match=name):
        getattr(sources, of)(name)

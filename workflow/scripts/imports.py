"""Which files a script, or a step of the command, imports: editing one of them reruns a rule.

Found in the source, without running it. A script depends on its sibling scripts and on modules of
the package; a step ``eofm STEP`` on the module of the command that defines it, on what is imported
at the top of that module and inside of the step's function, not on what other steps import. All of
it counts with what it imports in turn.
"""

import ast
from collections.abc import Iterator
from functools import cache
from pathlib import Path

SCRIPTS = Path(__file__).parent


class Sources:
    """The source of the package and of the scripts.

    Parameters
    ----------
    package : Path
        Folder of the package.
    scripts : Path
        Folder of the scripts.
    """

    def __init__(self, package: Path, scripts: Path = SCRIPTS) -> None:
        self.package, self.scripts = package, scripts
        self._known: dict[Path, set[Path]] = {}

    def of_script(self, name: str) -> set[Path]:
        """Files that a script imports, without the script itself.

        Raises
        ------
        LookupError
            If there is no such script.
        """
        path = self.scripts / name
        if not path.is_file():
            raise LookupError(f"no script is called {name}")
        return self._closure({path}) - {path}

    def of_step(self, name: str) -> set[Path]:
        """Files that the step ``eofm NAME`` imports, and the one that defines it.

        Raises
        ------
        LookupError
            If not one module of the command has a function of this name.
        """
        function = name.replace("-", "_")
        homes = [p for p in sorted(self.package.glob("app/**/*.py")) if function in _defined(p)]
        if len(homes) != 1:
            raise LookupError(f"{len(homes)} modules of the command define the step {name}")
        (home,) = homes
        nodes = [n for n in _tree(home).body if isinstance(n, ast.Import | ast.ImportFrom)]
        module = ast.Module([*nodes, *_reached(home, function)], [])
        return self._closure(self._imported(module, home)) | {home}

    def _closure(self, files: set[Path]) -> set[Path]:
        found: set[Path] = set()
        while files:
            found |= files
            for path in files - self._known.keys():
                self._known[path] = self._imported(_tree(path), path)
            files = {file for path in files for file in self._known[path]} - found
        return found

    def _imported(self, tree: ast.AST, path: Path) -> set[Path]:
        """Files that the statements of a tree import."""
        files: set[Path] = set()
        for node in ast.walk(tree):
            if isinstance(node, ast.Import):
                for alias in node.names:
                    files |= self._module(alias.name)
            elif isinstance(node, ast.ImportFrom):
                parent = self._absolute(node, path)
                for alias in node.names:
                    files |= self._module(f"{parent}.{alias.name}") or self._name(
                        parent, alias.name
                    )
            elif isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
                # The package looks names up when they are asked for.
                package = node.value.id == self.package.name
                files |= self._name(self.package.name, node.attr) if package else set()
        return files

    def _absolute(self, node: ast.ImportFrom, path: Path) -> str:
        if not node.level:
            return node.module or ""
        parts = path.relative_to(self.package.parent).with_suffix("").parts[: -node.level]
        return ".".join([*parts, *([node.module] if node.module else [])])

    def _module(self, name: str) -> set[Path]:
        """The file of a module, with the packages around it; none of others' modules."""
        parts = name.split(".")
        if parts[0] != self.package.name:
            path = self.scripts / f"{parts[0]}.py"
            return {path} if path.is_file() and len(parts) == 1 else set()
        path = self.package.parent.joinpath(*parts)
        file = path / "__init__.py" if path.is_dir() else path.with_suffix(".py")
        if not file.is_file():
            return set()
        around = [self.package.parent.joinpath(*parts[:n]) for n in range(1, len(parts))]
        return {file, *(folder / "__init__.py" for folder in around)}

    def _name(self, module: str, name: str) -> set[Path]:
        """The files behind a name that is imported from a module."""
        files = self._module(module)
        stub = self.package.parent.joinpath(*module.split("."), "__init__.pyi")
        if files and stub.is_file():
            for node in _tree(stub).body:
                if isinstance(node, ast.ImportFrom) and name in [a.name for a in node.names]:
                    found = self._absolute(node, stub)
                    files |= self._module(f"{found}.{name}") or self._module(found)
        return files


@cache
def _tree(path: Path) -> ast.Module:
    """The syntax of a file, but for what only type checkers read."""
    tree = ast.parse(path.read_text())
    tree.body = [n for n in tree.body if not _for_types(n)]
    return tree


def _for_types(node: ast.stmt) -> bool:
    return isinstance(node, ast.If) and ast.unparse(node.test).endswith("TYPE_CHECKING")


def _defined(path: Path) -> dict[str, ast.stmt]:
    """Functions, classes and values at the top of a module, by name."""
    return {name: node for node in _tree(path).body for name in _names(node)}


def _names(node: ast.stmt) -> Iterator[str]:
    if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
        yield node.name
    elif isinstance(node, ast.Assign | ast.AnnAssign):
        targets = node.targets if isinstance(node, ast.Assign) else [node.target]
        yield from (t.id for t in targets if isinstance(t, ast.Name))


def _reached(path: Path, function: str) -> list[ast.stmt]:
    """A function of a module and all in that module that it uses."""
    defined, queue, reached = _defined(path), [function], {}
    while queue:
        name = queue.pop()
        if name not in reached:
            reached[name] = defined[name]
            names = [n for n in ast.walk(defined[name]) if isinstance(n, ast.Name)]
            local = {n.id for n in names if isinstance(n.ctx, ast.Store)} - {name}
            # Parameters may be called as a step is.
            local |= {n.arg for n in ast.walk(defined[name]) if isinstance(n, ast.arg)}
            queue += sorted({n.id for n in names} & defined.keys() - local)
    return list(reached.values())

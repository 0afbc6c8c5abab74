"""The command ``eofm``: one subcommand per step, options named like the settings."""

import argparse
import logging
import signal
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from importlib.metadata import version
from typing import TYPE_CHECKING, NoReturn

from eofm import io
from eofm.app import steps, tiles
from eofm.app.options import Files, Step, StepParser, add_files, add_options, arguments_of
from eofm.errors import InputError
from eofm.settings import Section
from eofm.threads import use_threads

if TYPE_CHECKING:
    from eofm.flow.trust import Trust

# Neither module imports the other, so that a rule of one depends on what that one imports.
STEPS: tuple[Step, ...] = (*steps.STEPS, *tiles.STEPS)

# Exit status of a step whose result must not be trusted.
FAILED = 3

DESCRIPTION = """\
Displacement of soft samples between an image before and one after compression.

  eofm estimate before.tif after.tif --output displacement.tif

Displacements are in px: page 1 of the TIFF is lateral (to the right), page 2 axial
(down). Strain, error bars, figures and a page that explains them, in micrometres:

  eofm sample --reference before.tif --deformed after.tif --folder mine \\
      --lateral-size 3.9 --axial-size 6

Each step has a --help of its own.
"""


def main(argv: Sequence[str] | None = None) -> int:
    """Run one step.

    Returns 0 if it worked, 1 if its input cannot be used, and 3 if what it wrote must not be
    trusted; wrong usage ends with 2.
    """
    args = parser().parse_args(argv)
    try:
        return run(args)
    except (InputError, OSError, MemoryError) as error:
        print(f"eofm {_name(args.step)}: {in_words(error)}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        return 128 + signal.SIGINT


def run(args: argparse.Namespace) -> int:
    """Run the step of a parsed command line; return its exit status, see :func:`main`.

    Raises
    ------
    InputError
        If its input cannot be used.
    OSError, MemoryError
        If the machine fails it: what was asked for may work at another time.
    """
    name = _name(args.step)
    use_threads(args.threads)
    io.limit_size(args.max_size)
    given = arguments_of(args.step, args)
    Files.of(args.step, given).check()
    sections = {k: v.model_dump(mode="json") for k, v in given.items() if _is_section(v)}
    with _said(name), _ending_in_order(), io.together(), io.Origin(name, sections).recorded():
        trust: Trust | None = args.step(**given)
    if trust is None:
        return 0
    for reason in trust.reasons:
        print(f"eofm {name}: {trust.verdict}: {reason}", file=sys.stderr)
    return FAILED if trust.verdict == "failed" else 0


def in_words(error: BaseException) -> str:
    """What an error of :func:`run` says to the user."""
    if isinstance(error, MemoryError):
        return (
            "not enough memory for such sizes; use smaller images, windows or regions, or larger"
            " elements"
        )
    return str(error)


def _is_section(value: object) -> bool:
    return isinstance(value, Section)


@contextmanager
def _said(name: str) -> Iterator[None]:
    """Say on standard error, a line each, what the library notes of its input."""
    logger = logging.getLogger("eofm")
    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(logging.Formatter(f"eofm {name}: %(message)s"))
    level, logger.propagate = logger.level, False
    logger.addHandler(handler)
    logger.setLevel(logging.INFO)
    try:
        yield
    finally:
        logger.removeHandler(handler)
        logger.setLevel(level)
        logger.propagate = True


@contextmanager
def _ending_in_order() -> Iterator[None]:
    """End on SIGTERM as on an error: what was begun is cleared away."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return

    def end(*_: object) -> NoReturn:
        raise SystemExit(128 + signal.SIGTERM)

    before = signal.signal(signal.SIGTERM, end)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def _name(step: Step) -> str:
    return step.__name__.replace("_", "-")


def parser() -> argparse.ArgumentParser:
    """The parser of all steps."""
    formatter = argparse.RawDescriptionHelpFormatter
    words = argparse.ArgumentParser("eofm", description=DESCRIPTION, formatter_class=formatter)
    words.add_argument("--version", action="version", version=f"eofm {version('eofm')}")
    steps = words.add_subparsers(
        title="steps", metavar="STEP", required=True, parser_class=StepParser
    )
    for step in STEPS:
        summary, _, rest = (step.__doc__ or "").partition("\n")
        text = "\n".join(line.removeprefix("    ") for line in rest.splitlines())
        sub = steps.add_parser(
            _name(step),
            help=summary,
            description=summary + "\n" + text,
            formatter_class=formatter,
        )
        sub.set_defaults(step=step)
        add_files(sub, step)
        sub.add_argument(
            "--threads",
            type=int,
            metavar="N",
            help="cores to use (default: all); results do not depend on it",
        )
        sub.add_argument(
            "--max-size",
            type=float,
            metavar="GIB",
            help="largest image or field to read (default: a quarter of the memory there is)",
        )
        add_options(sub, step)
    return words


if __name__ == "__main__":
    sys.exit(main())

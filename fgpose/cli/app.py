"""From the arguments to the command, and from its errors to an exit code."""

from __future__ import annotations

import dataclasses
import errno
import inspect
import io
import itertools
import os
import pkgutil
import re
import sys
import traceback
import typing
import warnings
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager, nullcontext, redirect_stderr, redirect_stdout, suppress
from functools import cache, partial
from importlib.metadata import version
from pathlib import Path
from typing import Annotated, Any, Protocol, TextIO, runtime_checkable

import numpy as np

from fgpose.cli.command_list import print_commands
from fgpose.cli.console import as_wide_as_the_terminal, printable
from fgpose.cli.mistakes import in_one_line
from fgpose.cli.process import open_streams, say, set_arguments, signals_as_exceptions, silence_stdout
from fgpose.config import Config, load_config
from fgpose.extensions import added
from fgpose.io.atomic import NotWrittenError, no_empty_folders, not_written
from fgpose.plain_files import shortened

_DESCRIPTION = """3D human pose over time from several cameras, and their calibration from people or with a board.

Try it on a real recording that comes with fgpose: fgpose demo

Lengths are metres, times seconds, image errors pixels. --version prints the version; --traceback (or
FGPOSE_TRACEBACK=1) shows where an error comes from.
"""

FAILED = 2
"""Exit code after an error of the input or the system, which is one line on stderr."""
NOT_WRITTEN = 1
"""Exit code where the work is done, but a file could not be written."""
INTERRUPTED = 130
# 128 plus the number of the signal (SIGPIPE), as shells report it.
_BROKEN_PIPE = 141
# Longer than what is said of a file: the lines of a failed calibration, for one.
_MAX_MESSAGE = 4000
_EXPECTED = (ValueError, OSError, ImportError, MemoryError)
_GROUPS = {
    "start here": {"demo": "commands.demo:Demo"},
    "from videos and cameras": {
        "run": "commands.run:Run",
        "detect": "commands.detect:Detect",
        "live": "commands.live:Live",
    },
    "from keypoints": {
        "info": "commands.info:Info",
        "smooth": "commands.estimators:Smooth",
        "track": "commands.estimators:Track",
        "refine": "commands.estimators:Refine",
    },
    "calibration": {
        "calibrate": "commands.calibrate:Calibrate",
        "board": "boards:Board",
        "synchronise": "commands.synchronise:Synchronise",
    },
    "results": {
        "view": "commands.view:View",
        "report": "commands.report:Report",
        "overlay": "commands.view:Overlay",
        "angles": "commands.angles:Angles",
        "evaluate": "commands.evaluate:Evaluate",
    },
    "more": {
        "study": "commands.study:Study",
        "models": "commands.models:Models",
        "skeletons": "commands.models:Skeletons",
    },
}
"""Where in this room the class of each command is: only that of the command which is run is loaded."""
_PLACES = {name: place for group in _GROUPS.values() for name, place in group.items()}
_HELP, _HELP_ALL = {"-h", "--help"}, "--help-all"
_PARAMETERS_HIDDEN = "--help-all also lists the parameters of the estimation, which most recordings do not need."
_ESTIMATORS = ("run", "smooth", "track", "refine")
# Options whose value is a number: those that end with its unit.
_OPTION_OF_A_NUMBER = re.compile(r"--(fps|height|[\w.-]+[-_](s|m|px))")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command that the arguments name (sys.argv by default).

    Returns:
        The exit code: 0, 1 if a calibration has failed or a result could not be written, 2 after an error, 3 if a
        result is probably wrong and --strict was given, 130 after Ctrl-C, 141 if the reader of a pipe has gone.

    Raises:
        SystemExit: the arguments are wrong (2), ask for help (0), or SIGTERM came (143).
    """
    open_streams()
    arguments = list(sys.argv[1:] if arguments is None else arguments)
    with_traceback = "--traceback" in arguments or os.environ.get("FGPOSE_TRACEBACK", "") not in ("", "0")
    arguments = [argument for argument in arguments if argument != "--traceback"]
    with signals_as_exceptions() as interruption:
        try:
            try:
                return _run(arguments)
            finally:
                # Also of --help, which ends by SystemExit.
                sys.stdout.flush()
        except BaseException as error:
            if interruption.has_come or isinstance(error, KeyboardInterrupt):
                say(f"fgpose: interrupted{_kept(error)}\n")
                return INTERRUPTED
            if isinstance(error, BrokenPipeError):
                # The reader of a pipe has gone (fgpose info ... | head).
                silence_stdout()
                return _BROKEN_PIPE
            # LinAlgError is a ValueError, and a defect of ours, whatever the input.
            if not isinstance(error, _EXPECTED) or isinstance(error, np.linalg.LinAlgError):
                raise
            if with_traceback:
                say(traceback.format_exc())
            if _is_of_stdout(error):
                silence_stdout()
                error = not_written("the standard output", error)
            kept = _kept(error) if isinstance(error, NotWrittenError) else ""
            say(f"fgpose: error: {printable(_one_line(error))}{kept}\n")
            return NOT_WRITTEN if isinstance(error, NotWrittenError) else FAILED


def _kept(error: BaseException) -> str:
    """What of the work is not lost: commands say it as notes."""
    return "".join(f"; {printable(note)}" for note in getattr(error, "__notes__", ()))


def _run(arguments: list[str]) -> int:
    if arguments[:1] == ["--version"]:
        sys.stdout.write(f"fgpose {version('fgpose')}\n")
        return 0
    set_arguments(arguments)
    with _plain_warnings():
        command = _parse(arguments)
        output = getattr(command, "output", None)
        with no_empty_folders(output) if isinstance(output, Path) else nullcontext():
            return command.run() or 0


def _is_of_stdout(error: BaseException) -> bool:
    """All others name a file."""
    return isinstance(error, OSError) and error.errno == errno.ENOSPC and error.filename is None


@runtime_checkable
class Command(Protocol):
    """A dataclass whose fields are the options and whose docstring is the help."""

    def run(self) -> int | None:
        """Returns: the exit code; None: 0."""


def _ours(name: str) -> type:
    return pkgutil.resolve_name(f"fgpose.cli.{_PLACES[name]}")


def _of_others() -> dict[str, type]:
    """Commands that other packages add. Nobody replaces one of ours."""
    return {name: command for name, command in added("fgpose.commands").items() if name not in _PLACES}


def _list_commands() -> None:
    groups = {title: {name: _ours(name) for name in group} for title, group in _GROUPS.items()}
    others = _of_others()
    print_commands(groups | {"of other packages": others} if others else groups, _DESCRIPTION)


def _parse(arguments: list[str]) -> Command:
    if not arguments or arguments[0] in {*_HELP, _HELP_ALL}:
        _list_commands()
        raise SystemExit(0)
    import tyro

    _join_lines_of_help()
    name = arguments[0]
    # Others are loaded only where one of them may be meant.
    others = {} if name in _PLACES else _of_others()
    known = [*_PLACES, *others]
    if name not in known:
        say(f"fgpose: error: {printable(in_one_line('', arguments, known, ()) or '')}\n")
        raise SystemExit(FAILED)
    command = others[name] if name in others else _ours(name)
    completed = getattr(command, "completed", None)
    if completed is not None:
        arguments = [name, *completed(arguments[1:])]
    _check_decimal_points(arguments)
    config, hides_parameters = _config_of(arguments), _HELP_ALL not in arguments and bool(_HELP & set(arguments))
    arguments = [name, *("--help" if argument == _HELP_ALL else argument for argument in arguments[1:])]
    if name in _ESTIMATORS:
        # The values of --config become the defaults of the options, so that the command line overrides them.
        command = _with_defaults(command, config, hidden=hides_parameters)
    return _parsed(partial(tyro.cli, command, prog=f"fgpose {name}"), arguments, known)


@cache
def _join_lines_of_help() -> None:
    """Let lines of the help end where they are full. tyro ends them where those of a docstring end too: it takes lines
    that are indented for those of a list."""
    from tyro import _docstrings

    parse: Any = vars(_docstrings).get("parse_docstring_from_object")
    if parse is None:
        return  # in another tyro lines may be short, and no more

    def joined(kind: object) -> dict[str, str]:
        return {name: re.sub(r"(?<!\n)\n +", " ", text) for name, text in parse(kind).items()}

    vars(_docstrings)["parse_docstring_from_object"] = cache(joined)


def _parsed(parse: Callable[..., Command], arguments: list[str], known: Collection[str]) -> Command:
    """Raises SystemExit, 2 after a line that says what is wrong with the arguments."""
    box, printed = io.StringIO(), _like_stdout()
    try:
        with redirect_stderr(box), redirect_stdout(printed):
            return parse(args=arguments[1:])
    except SystemExit as end:
        printed.seek(0)
        sys.stdout.write(as_wide_as_the_terminal(printed.read()))
        if end.code == FAILED:
            line = in_one_line(_printed(parse, arguments[1:]), arguments, known, _options(parse, arguments))
            say(f"fgpose: error: {printable(line)}\n" if line else box.getvalue())
        raise


def _like_stdout() -> io.TextIOWrapper:
    """What is printed there gets the colours and frames that stdout would have."""
    memory = io.TextIOWrapper(io.BytesIO(), sys.stdout.encoding, errors="backslashreplace")
    vars(memory)["isatty"] = sys.stdout.isatty
    return memory


def _options(parse: Callable[..., Command], arguments: list[str]) -> set[str]:
    """Of the command that the arguments name, or of its part (models pull)."""
    words = itertools.takewhile(lambda argument: not argument.startswith("-"), arguments[1:2])
    return set(re.findall(r"--[\w.-]+", _printed(parse, [*words, "--help"])))


def _printed(parse: Callable[..., Command], arguments: list[str]) -> str:
    """What is printed of these arguments where lines may be very long."""
    printed = io.StringIO()
    columns = os.environ.get("COLUMNS")
    os.environ["COLUMNS"] = "1000"
    try:
        with redirect_stdout(printed), redirect_stderr(printed), suppress(SystemExit):
            parse(args=arguments)
    finally:
        os.environ.pop("COLUMNS") if columns is None else os.environ.update(COLUMNS=columns)
    return printed.getvalue()


def _check_decimal_points(arguments: list[str]) -> None:
    words = " ".join(arguments).replace("=", " ").split()
    for option, value in itertools.pairwise(words):
        if _OPTION_OF_A_NUMBER.fullmatch(option) and re.fullmatch(r"[+-]?\d*,\d+", value):
            raise ValueError(f"{option} {value}: write a point, {value.replace(',', '.')}")


def _with_defaults(command: type, config: Config, *, hidden: bool) -> type:
    """The same command with other defaults of its parameters, which its help lists or leaves out."""
    import tyro

    (parameters,) = (field for field in dataclasses.fields(command) if field.name == "parameters")
    kind = typing.get_type_hints(command, include_extras=True)["parameters"]
    field = (
        parameters.name,
        Annotated[kind, tyro.conf.Suppress] if hidden else kind,
        dataclasses.field(default=config),
    )
    document = inspect.cleandoc(command.__doc__ or "")
    document = f"{document}\n\n{_PARAMETERS_HIDDEN}" if hidden else document
    namespace = {"__doc__": document, "__module__": command.__module__}
    return dataclasses.make_dataclass(
        command.__name__, [field], bases=(command,), namespace=namespace, frozen=True, kw_only=True
    )


def _config_of(arguments: list[str]) -> Config:
    """The configuration of the file after --config, if there is one; the defaults otherwise."""
    if not arguments or arguments[0] not in _ESTIMATORS:
        return Config()
    for position, argument in enumerate(arguments):
        if argument.startswith("--config="):
            return load_config(Path(argument.removeprefix("--config=")))
        if argument == "--config" and position + 1 < len(arguments):
            return load_config(Path(arguments[position + 1]))
    return Config()


def _one_line(error: BaseException) -> str:
    """Not more than somebody reads: a message may quote all of a file."""
    if isinstance(error, OSError) and error.filename is not None and error.strerror:
        return shortened(f"{error.filename}: {error.strerror}")
    lines = [" ".join(line.split()) for line in str(error).splitlines()]
    return shortened("; ".join(line for line in lines if line) or type(error).__name__, _MAX_MESSAGE)


@contextmanager
def _plain_warnings() -> Iterator[None]:
    """Warnings as lines like those of errors, each once, without the place in the code."""
    said: set[str] = set()

    def show(
        message: Warning | str,
        category: type[Warning],
        filename: str,
        lineno: int,
        file: TextIO | None = None,
        line: str | None = None,
    ) -> None:
        text = printable(shortened(" ".join(str(message).split()), _MAX_MESSAGE))
        if text not in said:
            said.add(text)
            say(f"fgpose: warning: {text}\n")

    with warnings.catch_warnings():
        warnings.showwarning = show
        yield

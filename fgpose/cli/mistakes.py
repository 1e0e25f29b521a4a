"""What is wrong with the arguments, in one line as all other errors."""

from __future__ import annotations

import itertools
import re
from collections.abc import Collection, Sequence

from fgpose.shown.unknown_names import did_you_mean, nearest

_LINE = re.compile(r"[│| ] (.*?) *[│|]?")  # in the box
_NAME = re.compile(r" {4}(\S.*)")  # of an option; what it means is further to the right
_OF_THE_PROGRAM = ("--help", "--version", "--traceback")
_NUMBERS = {"<class 'int'>": "a whole number", "<class 'float'>": "a number"}


def in_one_line(text: str, arguments: Sequence[str], commands: Collection[str], options: Collection[str]) -> str | None:
    """The same as a box of tyro says; None if it is one of which nothing is known here.

    Args:
        text: the box, wide enough that nothing is broken into lines.
        arguments: of the program.
        commands: their names.
        options: of the command that the arguments name; "--rig".
    """
    lines = [found[1] for line in text.splitlines() if (found := _LINE.fullmatch(line.rstrip()))]
    lines = [line for line in lines if line.strip("─- ")]
    said = " ".join(line.strip() for line in lines)
    command = " ".join(["fgpose", *arguments[:1]])
    help_says = f"{command} --help lists what there is"
    if arguments and arguments[0].startswith("-"):
        meant = _meant(arguments[0], _OF_THE_PROGRAM)
        wrong = f"there is no option {arguments[0]}" if "?" in meant else f"a command comes before {arguments[0]}"
        return f"{wrong}{meant} fgpose --help lists all"
    if arguments and arguments[0] not in commands:
        return f"there is no command {arguments[0]}{_meant(arguments[0], commands)} fgpose --help lists all"
    if wrong := _wrong(arguments[1:], options):
        # What tyro says first may be what follows from it: "--Rig x" leaves x for the keypoints, or nothing.
        if any("." in name for name in wrong):
            help_says = help_says.replace("--help", "--help-all")
        return " ".join(f"there is no option {name}{_meant(name, options)}" for name in wrong) + f" {help_says}"
    if "Unrecognized options:" in said:
        unknown = _unknown(lines)
        if subcommands := re.search(r"Available subcommands: (\w+(, \w+)*)", said):
            meant = _meant(unknown[0], subcommands[1].split(", ")).rstrip(";")
            return f"{command} {unknown[0]} is none of {subcommands[1]}{meant}"
        wrong = [name for name in unknown if name.startswith("-")]
        if wrong:
            return " ".join(f"there is no option {name};" for name in wrong) + f" {help_says}"
        return f"nothing is expected at {' '.join(unknown)}; {help_says}"
    if missing := re.search(r"Missing from (fgpose[\w ]*):", said):
        needed = [found[1] for line in lines if (found := _NAME.fullmatch(line)) and not found[1].startswith("fgpose ")]
        return f"{missing[1]} needs {' and '.join(needed)}; {missing[1]} --help lists what there is"
    if found := re.search(r"invalid choice '(.*?)' for argument '(.*?)'. Expected one of \((.*?),?\)", said):
        choices = found[3].replace("'", "").split(", ")
        meant = did_you_mean(found[1], choices)
        return f"{found[2]} {found[1]}{meant}: choose {', '.join(choices[:-1])} or {choices[-1]}"
    if found := re.search(r"Missing value for argument '(.*?)'", said):
        if not found[1].startswith("-"):
            return f"{command} needs {found[1].upper()}; {help_says}"
        return f"{found[1]}: a value is missing"
    if found := re.search(r"Error parsing (\S+):", said):
        values = re.search(r"\[(.*?)\]", said)
        given = values[1].replace("'", "") if values else ""
        kind = next((words for name, words in _NUMBERS.items() if name in said), None)
        return f"{found[1]} {given}: {kind} is needed" if kind else f"{found[1]} {given} cannot be read; {help_says}"
    if arguments and (found := re.search(r"Expected one of \{(.*?)\}", said)):
        return f"{command} needs one of {found[1]}"
    return None


def _wrong(arguments: Sequence[str], options: Collection[str]) -> list[str]:
    """Long options that there are not. tyro also takes --min_confidence."""
    given = [argument.partition("=")[0] for argument in arguments if re.match(r"--\w", argument)]
    return [name for name in dict.fromkeys(given) if options and name.replace("_", "-") not in options]


def _unknown(lines: Sequence[str]) -> list[str]:
    """In one line, or one under the other."""
    at = next(n for n, line in enumerate(lines) if "Unrecognized options:" in line)
    same = lines[at].partition("options:")[2].strip()
    under = itertools.takewhile(lambda line: "full helptext" not in line, lines[at + 1 :])
    return same.split(", ") if same else [found[1] for line in under if (found := _NAME.fullmatch(line))]


def _meant(name: str, names: Collection[str]) -> str:
    """``"; did you mean --strict?"``, or the semicolon alone. --lag-s means --online.lag-s."""
    within = [each for each in names if each.endswith(f".{name.removeprefix('--')}")]
    near = within if len(within) == 1 else nearest(name, names)
    return f"; did you mean {near[0]}?" if near else ";"

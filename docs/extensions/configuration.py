"""``{configuration}``: every section and field of fgpose.Config with its default and its docstring."""

from __future__ import annotations

import dataclasses
import re
from typing import TYPE_CHECKING, Any, Literal, get_args, get_origin, get_type_hints

from docutils import nodes
from sphinx.pycode import ModuleAnalyzer
from sphinx.util.docutils import SphinxDirective

from fgpose import parameters
from fgpose.config import Config

if TYPE_CHECKING:
    from sphinx.application import Sphinx

_WORD_OF_OTHER_FIELD = re.compile(r"(?<![\w.`])([a-z]+\.[a-z0-9_]+)(?![\w`])")


def _docstrings() -> dict[tuple[str, str], str]:
    """By class and field; Python itself does not keep them."""
    found = ModuleAnalyzer.for_module("fgpose.parameters").find_attr_docs()
    return {key: " ".join(" ".join(lines).split()) for key, lines in found.items()}


def _kind(kind: Any) -> str:
    if get_origin(kind) is Literal:
        return "one of " + ", ".join(f"`{choice}`" for choice in get_args(kind))
    return {"bool": "true or false", "float": "number", "int": "whole number", "str": "text"}.get(kind.__name__, "")


def _default(value: object) -> str:
    return str(value).lower() if isinstance(value, bool) else str(value)


def markdown() -> str:
    """All sections, as MyST: a heading each, and a definition of each field with an anchor like motion.max_unseen_s."""
    docstrings, lines = _docstrings(), []
    known = {f"{s.name}.{f.name}" for s in dataclasses.fields(Config) for f in dataclasses.fields(_class_of(s.name))}

    def linked(match: re.Match[str]) -> str:
        return f"[`{match[1]}`](#{match[1]})" if match[1] in known else match[0]

    for section in dataclasses.fields(Config):
        cls = _class_of(section.name)
        lines += [f"## `[{section.name}]`", "", " ".join((cls.__doc__ or "").split()), ""]
        for field in dataclasses.fields(cls):
            name, kind = f"{section.name}.{field.name}", _kind(get_type_hints(cls)[field.name])
            told = _WORD_OF_OTHER_FIELD.sub(linked, docstrings[cls.__name__, field.name])
            lines += [f"({name})=", "", f"`{field.name}` = `{_default(field.default)}`", f": {told} *{kind}*", ""]
    return "\n".join(lines)


def _class_of(section: str) -> Any:
    return get_type_hints(Config)[section]


class ConfigurationDirective(SphinxDirective):
    """Takes no argument."""

    def run(self) -> list[nodes.Node]:
        self.env.note_dependency(parameters.__file__)
        return self.parse_text_to_nodes(markdown(), allow_section_headings=True)


def setup(app: Sphinx) -> dict[str, Any]:
    app.add_directive("configuration", ConfigurationDirective)
    return {"version": "1", "parallel_read_safe": True, "parallel_write_safe": True}

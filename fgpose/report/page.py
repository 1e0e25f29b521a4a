"""Sections as one HTML file that opens anywhere: style, program, figures and pictures are inside."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from importlib import metadata, resources
from typing import Any

from fgpose.finding import Finding
from fgpose.report.blocks import OfPerson, Section
from fgpose.report.plots import share_time


@dataclass(frozen=True)
class KeyFigure:
    """A number at the head of a page."""

    name: str
    value: str
    unit: str = ""
    note: str = ""


@dataclass(frozen=True)
class Headline:
    """What is said first."""

    heading: str
    intro: str
    suspicions: tuple[Finding, ...] = ()


@dataclass(frozen=True)
class Page:
    """What a file is made of."""

    title: str
    kicker: str
    """Above the title: what kind of page it is."""
    made: str
    """Below it: when, and from what."""
    sections: Sequence[Section]
    figures: Sequence[KeyFigure] = field(default_factory=tuple)
    verdict: Headline | None = None
    told: str = ""
    """Digest of what it was told beside its result (report.digest_of_told); empty: of nothing."""


def html(page: Page) -> str:
    """The text of the file. Raises ImportError, which says what to install, without Bokeh."""
    jinja2 = _jinja2()
    environment = jinja2.Environment(autoescape=True, trim_blocks=True, undefined=jinja2.StrictUndefined)
    plots = [plot for section in page.sections for plot in section.plots]
    share_time(plots)
    identifiers = {plot: f"plot-{n}" for n, plot in enumerate(plots)}
    return environment.from_string(_text("page.html")).render(
        page.__dict__,
        version=metadata.version("fgpose"),
        style=_text("page.css"),
        program=_text("page.js"),
        bokeh=_bokeh() if plots else "",
        identifiers=identifiers,
        people=people(page),
        plots=[{"identifier": identifiers[plot], "json": _json(plot.model)} for plot in plots],
    )


def people(page: Page) -> dict[str, bool]:
    """Those of whom one is shown at a time, in their order, and whether each is the first to be shown."""
    blocks = (block for section in page.sections for block in section.blocks)
    return {block.person: block.is_chosen for block in blocks if isinstance(block, OfPerson)}


def _jinja2() -> Any:
    try:
        import bokeh  # noqa: F401
        import jinja2
    except ImportError:
        raise ImportError("a report needs Bokeh: pip install 'fgpose[report]'") from None
    return jinja2


def _text(name: str) -> str:
    return resources.files("fgpose.report").joinpath(name).read_text(encoding="utf-8")


def _json(model: Any) -> str:
    from bokeh.embed import json_item

    # "</script>" in a name would end the script that holds it.
    return json.dumps(json_item(model)).replace("<", "\\u003c")


def _bokeh() -> str:
    """BokehJS without the parts that no figure here uses."""
    from bokeh.resources import Resources

    code = "\n".join(Resources(mode="inline", components=["bokeh"]).js_raw)
    return code.replace("</script", "<\\/script")

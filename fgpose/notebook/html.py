"""A summary as HTML: small tables that take the colours of the notebook, and perhaps a picture."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from html import escape

from fgpose.notebook.summary import Summary

_MOST_ROWS = 40
_SENTENCE = 25  # letters
_LEFT, _RIGHT = "text-align:left", "text-align:right"


def html(summary: Summary) -> str:
    """A fragment of a page. What is a name of somebody else's is escaped."""
    facts = "".join(
        f"<tr>{_cells('th', [name], _LEFT)}{_cells('td', [fact], _LEFT)}</tr>" for name, fact in summary.facts.items()
    )
    drawn = summary.picture() if summary.picture else ""
    picture = f'<div style="margin-left:1.5em">{drawn}</div>' if drawn else ""
    return (
        f'<div class="fgpose"><strong>{escape(summary.title)}</strong>'
        f'<div style="display:flex;flex-wrap:wrap;align-items:flex-start"><table>{facts}</table>{picture}</div>'
        f"{_table(summary.columns, summary.rows)}</div>"
    )


def _table(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    if not rows:
        return ""
    # Numbers end below each other, sentences begin so.
    styles = [_RIGHT if max(map(len, column)) < _SENTENCE else _LEFT for column in zip(*rows, strict=True)]
    body = "".join(
        f"<tr>{_cells('th', row[:1], _LEFT)}"
        f"{''.join(_cells('td', [text], style) for text, style in zip(row[1:], styles[1:], strict=True))}</tr>"
        for row in rows[:_MOST_ROWS]
    )
    left_out = f"<p>and {len(rows) - _MOST_ROWS} more</p>" if len(rows) > _MOST_ROWS else ""
    return f"<table><thead><tr>{_cells('th', columns, _LEFT)}</tr></thead><tbody>{body}</tbody></table>{left_out}"


def _cells(kind: str, texts: Iterable[str], style: str) -> str:
    return "".join(f'<{kind} style="{style}">{escape(text)}</{kind}>' for text in texts)

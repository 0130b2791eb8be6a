"""An experiment's report as one HTML page without scripts or anything from elsewhere.

Written with `html.escape` rather than a template language: the page is a few headings, tables and
images, and it is there without any extra installed.
"""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

from fgloc.report.experiment_report import Report, Table, Verdict
from fgloc.report.experiment_text import VERDICT, headings, lines, remarks, summary

STYLE = """\
body { font: 15px/1.5 system-ui, sans-serif; margin: 2rem auto; max-width: 72rem; padding: 0 1rem;
  color: #1a1a1a; background: #fff; }
h1 { font-size: 1.5rem; } h2 { font-size: 1.1rem; margin: 2rem 0 .5rem; }
.scroll { overflow-x: auto; }
table { border-collapse: collapse; font-variant-numeric: tabular-nums; }
th, td { padding: .2rem .8rem .2rem 0; text-align: right; white-space: nowrap;
  vertical-align: bottom; }
th { border-bottom: 1px solid #888; font-weight: 600; } tr + tr td { border-top: 1px solid #eee; }
.left { text-align: left; } .good { color: #006400; } .bad { color: #b00020; font-weight: 600; }
.remark { max-width: 60rem; margin: .4rem 0; color: #444; }
figure { margin: 2rem 0; } img { max-width: 100%; height: auto; } figcaption { color: #444; }
"""


def html(report: Report, figures: Sequence[tuple[str, str]], version: str) -> str:
    """Return the page; `figures` are (relative path, caption), `version` that of the program."""
    body = [f"<h1>{escape(report.title)}</h1>"]
    if report.notes:
        body.append("<ul>" + "".join(f"<li>{escape(n)}</li>" for n in report.notes) + "</ul>")
    if summary(report):
        body.append(f"<p><strong>{escape(summary(report))}.</strong></p>")
    for table in report.tables:
        body += [f'<h2 id="{escape(table.id)}">{escape(table.title)}</h2>', _table(table)]
        body += [f'<p class="remark">{escape(text)}</p>' for text in remarks(table)]
    for path, caption in figures:
        text = escape(caption)
        body.append(
            f'<figure><img src="{escape(path)}" alt="{text}">'
            f"<figcaption>{text}</figcaption></figure>"
        )
    body.append(f'<p class="remark">fgloc {escape(version)}</p>')
    return (
        '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(report.title)}</title>\n<style>\n{STYLE}</style>\n</head>\n<body>\n"
        + "\n".join(body)
        + "\n</body>\n</html>\n"
    )


def _table(table: Table) -> str:
    """Return one table; it scrolls by itself where the window is too narrow."""
    heads = headings(table)

    def css(k: int, text: str) -> str:
        names = ["left"] if k < len(table.labels) or heads[k] == VERDICT else []
        if heads[k] == VERDICT:
            bad = any(v.value in text for v in (Verdict.FAILED, Verdict.MISSING, Verdict.MISSED))
            names.append("bad" if bad else "good")
        return f' class="{" ".join(names)}"' if names else ""

    def cell(tag: str, k: int, text: str) -> str:
        return f"<{tag}{css(k, text)}>{escape(text).replace(chr(10), '<br>')}</{tag}>"

    rows = [heads, *lines(table)]
    body = [
        "<tr>" + "".join(cell("td" if n else "th", k, t) for k, t in enumerate(row)) + "</tr>"
        for n, row in enumerate(rows)
    ]
    return '<div class="scroll"><table>\n' + "\n".join(body) + "\n</table></div>"

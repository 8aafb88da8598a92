"""Sphinx configuration: `make docs` builds docs/_build/index.html."""

from __future__ import annotations

import dataclasses
import sys
from importlib import import_module
from pathlib import Path
from typing import Any

from docutils import nodes
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective

sys.path.insert(0, str(Path(__file__).parents[1]))

from jointest_ros.core.params import allowed_text

project = "jointest_ros"
author = "the jointest_ros developers"
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon"]
exclude_patterns = ["_build"]
html_theme = "furo"
html_title = "jointest_ros"
myst_heading_anchors = 3
napoleon_custom_sections = [("Class attributes", "Attributes"), ("Instance attributes", "Attributes")]
autodoc_typehints = "description"
autodoc_member_order = "bysource"


class Parameters(SphinxDirective):
    """`{parameters} module:attribute`: a table of what a `Params` class declares, so that no page repeats it."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        """The table."""
        module, path = self.arguments[0].split(":")
        declared: Any = import_module(module)
        for name in path.split("."):
            declared = declared[name] if isinstance(declared, dict) else getattr(declared, name)
        rows = [
            (field.name, _default(field.default), allowed_text(field), field.metadata["description"])
            for field in dataclasses.fields(declared)
        ]
        return [_table(("parameter", "default", "allowed", "meaning"), rows)]


def _default(value: object) -> str:
    return str(value).lower() if isinstance(value, bool) else "''" if value == "" else str(value)


def _table(heading: tuple[str, ...], rows: list[tuple[str, ...]]) -> nodes.table:
    def row(cells: tuple[str, ...], literal: bool) -> nodes.row:
        made = nodes.row()
        for number, cell in enumerate(cells):
            text = nodes.literal(text=cell) if literal and number < 2 else nodes.Text(cell)
            made += nodes.entry("", nodes.paragraph("", "", text))
        return made

    group = nodes.tgroup(cols=len(heading))
    group += [nodes.colspec(colwidth=width) for width in (20, 12, 22, 46)]
    group += nodes.thead("", row(heading, literal=False))
    group += nodes.tbody("", *[row(cells, literal=True) for cells in rows])
    return nodes.table("", group)


def setup(app: Sphinx) -> None:
    """Called by Sphinx."""
    app.add_directive("parameters", Parameters)

"""Sphinx's settings: the manual from ``docs/`` and the docstrings. `sphinx-build -W --keep-going -n docs OUT`."""

from __future__ import annotations

import re
import sys
from importlib import import_module
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE.parent), str(HERE)]

from docutils import nodes  # noqa: E402
from latex2mathml.converter import convert  # noqa: E402

from tcdyn.version import __version__ as release  # noqa: E402

project, author, copyright = "tcdyn", "The tcdyn developers", "The tcdyn developers, MIT licence"
version = release
extensions = ["sphinx.ext.autodoc", "sphinx.ext.napoleon", "myst_parser"]
myst_enable_extensions = ["dollarmath", "amsmath", "colon_fence", "deflist"]
myst_heading_anchors = 3
exclude_patterns = ["_build"]
html_theme = "pydata_sphinx_theme"
html_math_renderer = "mathml"  # of the browser itself: no script, no network, and it prints
html_title = f"tcdyn {release}"
html_show_sourcelink = False
html_theme_options = {
    "navigation_with_keys": False,
    "show_toc_level": 2,
    "footer_start": ["copyright"],
    "footer_end": ["sphinx-version"],
    "show_prev_next": True,
}
html_static_path = ["_static"]
html_css_files = ["manual.css"]
html_copy_source = False
PAGES_WITHOUT_SUBPAGES = (
    "index",
    "start",
    "which",
    "gallery/index",
    "files",
    "glossary",
    "coming-from",
    "limits",
    "validation",
    "performance",
    "development",
)
html_sidebars: dict[str, list[str]] = {page: [] for page in PAGES_WITHOUT_SUBPAGES}

autodoc_member_order = "bysource"
autodoc_typehints_format = "short"
napoleon_numpy_docstring = False
python_use_unqualified_type_names = True
python_maximum_signature_line_length = 88
# what annotations name is numpy's, pandas' and private types'; roles in the pages ({func}, {meth}, {mod}) stay checked
nitpick_ignore_regex = [("py:(class|data|obj|exc|attr)", ".*")]

ROOMS = {  # heading of a page, and the modules or packages on it
    "calibration": ["calibration"],
    "immersion": ["immersion"],
    "chain": ["tcdyn.chain", "tcdyn.contact", "tcdyn.fitting", "tcdyn.traces"],
    "compensate": ["tcdyn.compensate"],
    "identify": ["tcdyn.identify"],
    "sensor": ["tcdyn.sensor", "tcdyn.plunge"],
    "conduction": ["tcdyn.conduction"],
    "partition": ["tcdyn.partition", "tcdyn.campaign"],
    "design": ["tcdyn.design", "tcdyn.simulate", "tcdyn.verify"],
    "pipeline": ["tcdyn.pipeline", "tcdyn.plots", "tcdyn.report"],
}


def _modules(package: str) -> list[str]:
    """A package's modules by their dotted names, its folders after its files."""
    path = HERE.parent.joinpath(*package.split("."))
    if not path.is_dir():
        return [package]
    files = sorted(path.rglob("*.py"), key=lambda p: (len(p.parts), p))
    names = [".".join(p.relative_to(HERE.parent).with_suffix("").parts) for p in files]
    return [name.removesuffix(".__init__") for name in names]


def write_reference(*_: Any) -> None:
    """A page for each room, so that a new file of the house stands in the manual without being listed."""
    folder = HERE / "reference" / "rooms"
    folder.mkdir(parents=True, exist_ok=True)
    for title, packages in ROOMS.items():
        page = [f"# {title}", ""]
        for module in (m for package in packages for m in _modules(package)):
            page += [f"## {module}", "", "```{eval-rst}", f".. automodule:: {module}", "   :members:"]
            page += ["   :ignore-module-all:", "```", ""]
        file, text = folder / f"{title}.md", "\n".join(page)
        if not file.exists() or file.read_text(encoding="utf-8") != text:
            file.write_text(text, encoding="utf-8")


def plain(app: Any, what: str, name: str, thing: Any, options: Any, lines: list[str]) -> None:
    """Docstrings are prose with formulas: bars, stars and trailing underscores in them are no markup."""
    quoted = False
    for k, line in enumerate(lines):
        if line.lstrip().startswith(">>>"):
            quoted = True
        elif not line.strip():
            quoted = False
        if not quoted:
            parts = re.split(r"(``.+?``|:\w+:`.+?`|`.+?`)", line)
            parts[::2] = [re.sub(r"(?<!\*)\*(?!\*)|\||(?<=\w)_(?!\w)", r"\\\g<0>", part) for part in parts[::2]]
            lines[k] = "".join(parts)


def at_home(app: Any, env: Any, node: Any, text: Any) -> Any:
    """A name by which a room offers something (``tcdyn.smooth``), or by which a module knows it, leads to its home."""
    if node.get("refdomain") != "py":
        return None
    target, module = node["reftarget"], node.get("py:module")
    for name in (target, f"{module}.{target}"):
        thing = _offered(name)
        home = f"{getattr(thing, '__module__', '')}.{getattr(thing, '__qualname__', '')}"
        if thing is not None and home != target:
            found = env.domains["py"].resolve_xref(env, node["refdoc"], app.builder, node["reftype"], home, node, text)
            if found is not None:
                return found
    return None


def _offered(name: str) -> Any:
    """What a dotted name means when Python reads it, None where it means nothing."""
    parts = name.split(".")
    for k in range(len(parts) - 1, 0, -1):
        try:
            thing = import_module(".".join(parts[:k]))
        except ImportError:
            continue
        for part in parts[k:]:
            thing = getattr(thing, part, None)
        return thing
    return None


def mathml(self: Any, node: Any) -> None:
    """An equation as MathML, inline or in a line of its own."""
    block = isinstance(node, nodes.math_block)
    written = convert(node.astext(), display="block" if block else "inline")
    self.body.append(f'<div class="math">{written}</div>' if block else written)
    raise nodes.SkipNode


def setup(app: Any) -> None:
    """Hooks of the build."""
    app.add_html_math_renderer("mathml", inline_renderers=(mathml, None), block_renderers=(mathml, None))
    app.connect("missing-reference", at_home)
    app.connect("builder-inited", write_reference)
    app.connect("autodoc-process-docstring", plain, priority=900)

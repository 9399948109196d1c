"""Settings of Sphinx for the manual: `sphinx-build -W --keep-going -n docs OUT`."""

from __future__ import annotations

import json
import os
import re
import shutil
import sys
import tempfile
from importlib import import_module
from inspect import isclass, isfunction
from pathlib import Path
from typing import Any

HERE = Path(__file__).parent
sys.path[:0] = [str(HERE.parent), str(HERE / "gallery")]

from docutils import nodes  # noqa: E402
from latex2mathml.converter import convert  # noqa: E402
from shared import lab  # noqa: E402
from sphinx.errors import SphinxError  # noqa: E402
from sphinx.transforms.post_transforms import SphinxPostTransform  # noqa: E402

from tcdyn.version import __version__ as release  # noqa: E402

project, author, copyright = "tcdyn", "The tcdyn developers", "The tcdyn developers, MIT licence"
version = release
extensions = [
    "sphinx.ext.autodoc",
    "sphinx.ext.autosummary",
    "sphinx.ext.napoleon",
    "myst_nb",
    "sphinx_gallery.gen_gallery",
]
templates_path = ["_templates"]
autosummary_ignore_module_all = False
myst_enable_extensions = ["dollarmath", "amsmath", "colon_fence", "deflist"]
myst_heading_anchors = 3
exclude_patterns = ["_build", "_lab", "gallery"]

# Pages with code cells are executed when the manual is built, each in a new folder; an error or an
# exit code other than 0 is a warning, and so fails the build with -W. Their commands find this
# package; TCDYN_LAB is the folder of `tcdyn demo`. The pages are plain notebooks; `shell_cells.py`
# runs their commands here.
nb_execution_mode = "force"
nb_execution_in_temp = True
nb_execution_show_tb = True
nb_execution_timeout = 900
nb_merge_streams = True
nb_number_source_lines = False
os.environ |= {
    "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}",
    "PYTHONPATH": str(HERE.parent),
    "COLUMNS": "100",
    "IPYTHONDIR": tempfile.mkdtemp(),
}
os.environ.pop("MPLBACKEND", None)  # kernels show figures below their cells
startup = Path(os.environ["IPYTHONDIR"]) / "profile_default" / "startup"
startup.mkdir(parents=True)
shutil.copy(HERE / "shell_cells.py", startup)

sphinx_gallery_conf = {
    "examples_dirs": "gallery",
    "gallery_dirs": "auto_gallery",
    "filename_pattern": r"\.py$",
    "ignore_pattern": r"shared\.py$",
    "subsection_order": [
        f"gallery/{name}" for name in ("any", "identification", "disk", "test", "rim")
    ],
    "within_subsection_order": "FileNameSortKey",
    "write_computation_times": False,
    "min_reported_time": 600,
    "parallel": True,
    "notebook_extensions": [],
    "capture_repr": (),  # no "<Axes ..>" below a figure
}
html_theme = "pydata_sphinx_theme"
html_math_renderer = "mathml"  # rendered by the browser: no script, no network
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
    "auto_gallery/index",
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
napoleon_numpy_docstring = True
napoleon_use_rtype = False
suppress_warnings = ["ref.python"]  # names of returned values equal names of fields
python_use_unqualified_type_names = True
python_maximum_signature_line_length = 88
# Annotations name types of other packages and private types; the roles {func}, {meth}, {mod} in the
# pages are checked.
nitpick_ignore_regex = [("py:(class|data|obj|exc|attr)", ".*")]

# Modules whose names are public; each name has its own page, under the first module that has it.
PUBLIC_MODULES = (
    "tcdyn",
    "tcdyn.chain",
    "tcdyn.smoothing",
    "tcdyn.identification",
    "tcdyn.sensors",
    "tcdyn.estimation",
    "tcdyn.campaign",
    "tcdyn.workflows",
    "tcdyn.plots",
)
REFERENCE_PAGES = {  # heading of a page of internals, and the modules or packages on it
    "calibration": ["calibration"],
    "immersion": ["immersion"],
    "core": ["tcdyn.core"],
    "io": ["tcdyn.io"],
    "estimation": ["tcdyn.estimation"],
    "series": ["tcdyn.series"],
    "rig": ["tcdyn.rig"],
    "chain": ["tcdyn.chain"],
    "heat": ["tcdyn.heat"],
    "smoothing": ["tcdyn.smoothing"],
    "identification": ["tcdyn.identification", "tcdyn.tuning"],
    "sensors": ["tcdyn.sensors"],
    "partition": ["tcdyn.partition", "tcdyn.campaign"],
    "design": ["tcdyn.design", "tcdyn.simulate", "tcdyn.verify"],
    "workflows": ["tcdyn.workflows", "tcdyn.plots", "tcdyn.report"],
}


def _modules(package: str) -> list[str]:
    """The dotted names of a package's modules, files before folders."""
    path = HERE.parent.joinpath(*package.split("."))
    if not path.is_dir():
        return [package]
    files = sorted(path.rglob("*.py"), key=lambda p: (len(p.parts), p))
    names = [".".join(p.relative_to(HERE.parent).with_suffix("").parts) for p in files]
    return [name.removesuffix(".__init__") for name in names]


SEARCH_TERMS = (
    "thermowell",
    "timestamp",
    "datetime",
    "PI",
    "xarray",
    "pandas",
    "dip",
    "certificate",
    "German",
)


def make_lab(app: Any) -> None:
    """Make the folder of `tcdyn demo` before the first page and the first example need it."""
    if app.config.nb_execution_mode != "off":
        os.environ["TCDYN_LAB"] = str(lab())


def check_search(app: Any, error: Exception | None) -> None:
    """Fail the build if the search does not find what people look for."""
    if error is None and app.builder.name == "html":
        text = (app.outdir / "searchindex.js").read_text(encoding="utf-8")
        terms = json.loads(text.removeprefix("Search.setIndex(").removesuffix(")"))["terms"]
        stem = app.builder.indexer.lang.stem
        missing = [term for term in SEARCH_TERMS if stem(term.lower()) not in terms]
        if missing:
            raise SphinxError(f"the search does not find {', '.join(missing)}")


def public_names(module_name: str, listed: set[int]) -> list[str]:
    """Public functions and classes of a module not yet in ``listed``, to which they are added."""
    module = import_module(module_name)
    names = []
    for name in module.__all__:
        item = getattr(module, name)
        if (isclass(item) or isfunction(item)) and id(item) not in listed:
            listed.add(id(item))
            names.append(f"{module_name}.{name}")
    return names


def _write(file: Path, lines: list[str]) -> None:
    """Write a page if its text differs."""
    file.parent.mkdir(parents=True, exist_ok=True)
    text = "\n".join(lines)
    if not file.exists() or file.read_text(encoding="utf-8") != text:
        file.write_text(text, encoding="utf-8")


def write_reference(*_: Any) -> None:
    """Write the list of public names, and a page of internals for each group of packages.

    New names and modules appear without being listed.
    """
    page = ["# Public names", ""]
    listed: set[int] = set()
    for module_name in PUBLIC_MODULES:
        page += [f"## {module_name}", "", "```{eval-rst}", ".. autosummary::"]
        page += ["   :toctree: names", "   :nosignatures:", ""]
        page += [f"   {name}" for name in public_names(module_name, listed)]
        page += ["```", ""]
    _write(HERE / "reference" / "public.md", page)
    folder = HERE / "reference" / "packages"
    for title, packages in REFERENCE_PAGES.items():
        page = [f"# {title}", ""]
        for module in (m for package in packages for m in _modules(package)):
            page += [
                f"## {module}",
                "",
                "```{eval-rst}",
                f".. automodule:: {module}",
                "   :members:",
            ]
            page += ["   :ignore-module-all:", "```", ""]
        _write(folder / f"{title}.md", page)


def escape_markup(
    app: Any, what: str, name: str, thing: Any, options: Any, lines: list[str]
) -> None:
    """Escape bars, stars and trailing underscores, which belong to formulas in docstrings."""
    quoted = False
    for k, line in enumerate(lines):
        if line.lstrip().startswith(">>>"):
            quoted = True
        elif not line.strip():
            quoted = False
        if not quoted:
            # a list item that napoleon made of a returned value: "* *name* -- text"
            item = re.match(r"((?:\s*|:returns: )\* (?:\*[^*]+\*)?)?(.*)", line)
            bullet, line = item.groups(default="") if item else ("", line)
            parts = re.split(r"(``.+?``|:\w+:`.+?`|`.+?`)", line)
            parts[::2] = [
                re.sub(r"(?<!\*)\*(?!\*)|\||(?<=\w)_(?!\w)", r"\\\g<0>", part)
                for part in parts[::2]
            ]
            lines[k] = bullet + "".join(parts)


def resolve_alias(app: Any, env: Any, node: Any, text: Any) -> Any:
    """Resolve a re-exported name (``tcdyn.smooth``) to the place where it is defined."""
    if node.get("refdomain") != "py":
        return None
    target = node["reftarget"]
    # a page of a public name refers to the module in which the name is defined
    documented = _object_at(node["refdoc"].rpartition("/")[2])
    modules = (node.get("py:module"), getattr(documented, "__module__", ""), *PUBLIC_MODULES)
    for name in (target, *(f"{module}.{target}" for module in modules if module)):
        thing = _object_at(name)
        definition = f"{getattr(thing, '__module__', '')}.{getattr(thing, '__qualname__', '')}"
        if thing is not None and definition != target:
            resolved = env.domains["py"].resolve_xref(
                env, node["refdoc"], app.builder, node["reftype"], definition, node, text
            )
            if resolved is not None:
                return resolved
    return None


def _object_at(name: str) -> Any:
    """The object that a dotted name refers to, or None."""
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
    """An equation as MathML, inline or displayed."""
    block = isinstance(node, nodes.math_block)
    written = convert(node.astext(), display="block" if block else "inline")
    self.body.append(f'<div class="math">{written}</div>' if block else written)
    raise nodes.SkipNode


class ShellCells(SphinxPostTransform):
    """Show a cell that begins with ``%%sh`` as commands of the shell."""

    default_priority = 1

    def run(self, **kwargs: Any) -> None:
        """Replace the cells of a page."""
        for cell in list(self.document.findall(nodes.literal_block)):
            first, _, commands = cell.astext().partition("\n")
            if first.startswith("%%sh"):
                cell.replace_self(nodes.literal_block(commands, commands, language="sh"))


def setup(app: Any) -> None:
    """Connect the functions above to the build."""
    app.add_post_transform(ShellCells)
    app.add_html_math_renderer(
        "mathml", inline_renderers=(mathml, None), block_renderers=(mathml, None)
    )
    app.connect("builder-inited", make_lab, priority=1)
    app.connect("build-finished", check_search)
    app.connect("missing-reference", resolve_alias)
    app.connect("config-inited", write_reference)  # before the files are listed
    app.connect("autodoc-process-docstring", escape_markup, priority=900)

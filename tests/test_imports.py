"""Which module may import which; imports inside functions count, relative ones are not used."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]

BASE = {
    f"vo.{name}"
    for name in (
        *("errors", "types", "failures", "faults", "calibration_errors"),
        *("bounded_documents", "bounded_files", "extras", "printable"),
        *("given_images", "grey_stretch"),
        *("closed_loops", "seen_markers", "feature_settings", "metric_scale", "inertial_use"),
        "placed_frames",
        *("config", "settings", "image_areas", "scheduling", "stopwatch"),
        *("noise_classes", "version"),
    )
}
GROUND = BASE | {"vo.compiling", "vo.geometry", "vo.formats"}
OUTER = {
    f"vo.{name}"
    for name in ("sources", "evaluation", "recording", "results", "scaling", "streaming")
}
# Floors of the odometry: a room imports from floors below its own, never from one beside it.
FLOORS = (
    {"vo.frontend"},
    {"vo.learned"},
    {"vo.mapping", "vo.features", "vo.markers"},
    {"vo.places", "vo.inertial"},
    {"vo.tracking", "vo.backend", "vo.refinement"},
    {"vo.trajectory"},
    {"vo.inertial_placement"},
    {"vo.map_updater", "vo.snapshot", "vo.memory", "vo.inertial_gaps", "vo.inertial_turns"},
    {"vo.map_creator", "vo.inertial_alignment"},
    {"vo.placement"},
    {"vo.stages"},
    {"vo.odometry"},
)
CORE_CASES = (
    ("vo.mapping.local_map", "import vo.tracking.tracker", "vo.mapping must not know vo.tracking"),
    ("vo.tracking.tracker", "import vo.backend.gauge", "vo.tracking must not know vo.backend"),
    ("vo.refinement.bias", "import vo.backend", "vo.refinement must not know vo.backend"),
    ("vo.frontend.orb", "import vo.mapping", "vo.frontend must not know vo.mapping"),
    ("vo.places.records", "import vo.backend", "vo.places must not know vo.backend"),
    ("vo.trajectory.store", "import vo.odometry", "vo.trajectory must not know vo.odometry"),
)


def _below(floor: int) -> set[str]:
    return {room for rooms in FLOORS[:floor] for room in rooms}


# What each room may import besides itself; a new room needs a line here.
ALLOWED = {
    # Type checkers see the public names, which are imported when they are first used.
    "vo": GROUND
    | OUTER
    | {"vo.api", "vo.backend", "vo.features", "vo.markers", "vo.rendering", "vo.stages"}
    | {"vo.objects"},
    "vo.api": GROUND
    | OUTER
    | {"vo.features", "vo.markers", "vo.odometry", "vo.run_recording", "vo.stages", "vo.warmup"}
    | {"vo.memory", "vo.objects", "vo.places"},
    **{module: BASE for module in BASE},
    "vo.progress": BASE,
    "vo.interrupts": BASE,
    "vo.compiling": set(),
    "vo.geometry": BASE | {"vo.compiling"},
    "vo.formats": BASE | {"vo.compiling", "vo.geometry"},
    **{room: GROUND | _below(n) for n, rooms in enumerate(FLOORS) for room in rooms},
    "vo.odometry": GROUND | _below(len(FLOORS) - 1) | {"vo.warmup"},
    **{room: GROUND for room in OUTER},
    "vo.scaling": GROUND | {"vo.markers", "vo.sources"},
    "vo.results": GROUND,
    "vo.calibrating": GROUND,
    "vo.markers": GROUND | {"vo.calibrating"},
    "vo.inspection": GROUND | {"vo.sources", "vo.frontend"},
    "vo.laboratory": GROUND
    | {"vo.features", "vo.frontend", "vo.places", "vo.sources", "vo.evaluation"},
    "vo.objects": GROUND | {"vo.features", "vo.frontend"},
    "vo.report": GROUND | {"vo.evaluation", "vo.results"},
    "vo.rendering": GROUND | {"vo.report", "vo.sources"},
    "vo.batch": GROUND
    | {"vo.evaluation", "vo.report", "vo.results", "vo.run_recording", "vo.sources"},
    "vo.warmup": GROUND | {"vo.inertial", "vo.mapping", "vo.places"},
    "vo.run_scale": GROUND | OUTER | {"vo.markers", "vo.trajectory"},
    "vo.run_session": GROUND
    | OUTER
    | {"vo.trajectory", "vo.odometry", "vo.progress", "vo.interrupts", "vo.run_scale"},
    "vo.run_recording": GROUND
    | OUTER
    | {"vo.trajectory", "vo.odometry", "vo.progress", "vo.run_session", "vo.stages"}
    | {"vo.inertial"},
    "vo.cli": GROUND
    | OUTER
    | {"vo", "vo.report", "vo.calibrating", "vo.inspection", "vo.progress", "vo.backend"}
    | {"vo.odometry", "vo.run_recording", "vo.warmup", "vo.features", "vo.learned"}
    | {
        "vo.laboratory",
        "vo.markers",
        "vo.rendering",
        "vo.places",
        "vo.batch",
        "vo.objects",
        "vo.api",
    }
    | {"data_synth"},
    "vo.__main__": {"vo.cli"},
    "data_synth": {"vo.version", "vo.errors", "vo.extras", "vo.types", "vo.settings"}
    | {"vo.compiling", "vo.geometry", "vo.formats"},
}
ONLY_IN = {"gtsam": "vo.backend", "rerun": "vo.recording", "typer": "vo.cli"}
BANNED_NAMES = {"utils", "util", "common", "helpers", "helper", "tools", "misc"}


@dataclass(frozen=True)
class Import:
    """`importer` imports `target`; both are modules, or the target a package of someone else."""

    importer: str
    target: str
    line: int
    only_for_types: bool


def find_modules(root: Path) -> dict[str, Path]:
    """Modules of the project by dotted name."""
    files = [p for package in ("vo", "data_synth") for p in (root / package).rglob("*.py")]
    return {_dotted(path.relative_to(root)): path for path in sorted(files)}


def _dotted(path: Path) -> str:
    parts = path.with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def find_imports(modules: dict[str, Path]) -> list[Import]:
    """Every import of every module."""
    found = []
    for name, path in modules.items():
        tree = ast.parse(path.read_text(encoding="utf-8"), str(path))
        for node, only_for_types in _import_nodes(tree, False):
            for target in _targets(node, modules):
                found.append(Import(name, target, node.lineno, only_for_types))
    return found


def _import_nodes(
    node: ast.AST, only_for_types: bool
) -> Iterator[tuple[ast.Import | ast.ImportFrom, bool]]:
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.Import | ast.ImportFrom):
            yield child, only_for_types
        elif isinstance(child, ast.If) and "TYPE_CHECKING" in ast.unparse(child.test):
            for part in child.body:
                yield from _import_nodes(ast.Module([part], []), True)
            for part in child.orelse:
                yield from _import_nodes(ast.Module([part], []), only_for_types)
        else:
            yield from _import_nodes(child, only_for_types)


def _targets(node: ast.Import | ast.ImportFrom, modules: dict[str, Path]) -> list[str]:
    if isinstance(node, ast.Import):
        return [alias.name for alias in node.names]
    if node.level:
        return ["." * node.level + (node.module or "")]
    module = node.module or ""
    return [
        f"{module}.{alias.name}" if f"{module}.{alias.name}" in modules else module
        for alias in node.names
    ]


def room_of(module: str) -> str:
    """`vo.frontend` for `vo.frontend.orb`, `vo.run_recording`, `data_synth` for all of it."""
    parts = module.split(".")
    return "data_synth" if parts[0] == "data_synth" else ".".join(parts[:2])


def find_violations(root: Path) -> list[str]:
    """One line for each broken rule."""
    modules = find_modules(root)
    imports = find_imports(modules)
    return [
        *_bad_names(modules),
        *(line for each in imports if (line := _wrong_way(each)) is not None),
        *_cycles(modules, imports),
    ]


def _bad_names(modules: dict[str, Path]) -> list[str]:
    lines = []
    for name in modules:
        if BANNED_NAMES & set(name.split(".")):
            lines.append(f"{name}: a module's name says what it owns")
        if room_of(name) not in ALLOWED:
            lines.append(f"{name}: room {room_of(name)} has no rule in {Path(__file__).name}")
    return lines


def _wrong_way(each: Import) -> str | None:
    room, target_root = room_of(each.importer), each.target.split(".")[0]
    where = f"{each.importer}:{each.line} imports {each.target}"
    if each.target.startswith("."):
        return f"{where}: relative imports hide the room"
    if target_root in ONLY_IN and room != ONLY_IN[target_root]:
        return f"{where}: only {ONLY_IN[target_root]} may"
    if target_root in ("vo", "data_synth"):
        target = room_of(each.target)
        if target != room and target not in ALLOWED.get(room, set()):
            return f"{where}: {room} must not know {target}"
    return None


def _cycles(modules: dict[str, Path], imports: list[Import]) -> list[str]:
    """Modules that reach themselves; imports for types only are no dependency at run time."""
    graph: dict[str, set[str]] = {name: set() for name in modules}
    for each in imports:
        if each.target in modules and each.target != each.importer and not each.only_for_types:
            graph[each.importer].add(each.target)
    return [f"{name} imports itself in a circle" for name in graph if name in _reach(graph, name)]


def _reach(graph: dict[str, set[str]], start: str) -> set[str]:
    reached: set[str] = set()
    waiting = list(graph[start])
    while waiting:
        name = waiting.pop()
        if name not in reached:
            reached.add(name)
            waiting.extend(graph[name])
    return reached


def test_project_keeps_the_import_rules() -> None:
    assert len(find_modules(ROOT)) > 20
    assert find_violations(ROOT) == []


@pytest.mark.parametrize(
    ("module", "code", "complaint"),
    [
        ("vo.types", "import vo.geometry.pnp", "vo.types must not know vo.geometry"),
        ("vo.geometry.pnp", "from vo import formats", "vo.geometry must not know vo.formats"),
        ("vo.frontend.orb", "import vo.sources", "vo.frontend must not know vo.sources"),
        ("vo.odometry", "from vo.recording import x", "vo.odometry must not know vo.recording"),
        ("vo.run_recording", "import vo.cli.app", "vo.run_recording must not know vo.cli"),
        ("vo.run_recording", "import data_synth", "vo.run_recording must not know data_synth"),
        ("data_synth.room", "import vo.config", "data_synth must not know vo.config"),
        ("vo.mapping.local_map", "import gtsam", "only vo.backend may"),
        ("vo.run_recording", "from rerun.blueprint import Grid", "only vo.recording may"),
        ("vo.run_recording", "import typer", "only vo.cli may"),
        ("vo.mapping.local_map", "from . import x", "relative imports hide the room"),
        ("vo.mapping.utils", "", "a module's name says what it owns"),
        ("vo.newroom.thing", "", "room vo.newroom has no rule"),
        *CORE_CASES,
    ],
)
@pytest.mark.parametrize(
    "form", ["{}", "def f():\n    {}", "try:\n    {}\nexcept ImportError:\n    pass"]
)
def test_a_broken_rule_is_found(
    tmp_path: Path, module: str, code: str, complaint: str, form: str
) -> None:
    _write(tmp_path, "vo.formats", "")
    _write(tmp_path, module, form.format(code or "pass"))
    violations = find_violations(tmp_path)
    assert len(violations) == 1
    assert complaint in violations[0]


def test_a_type_only_import_of_a_higher_room_is_found(tmp_path: Path) -> None:
    code = "from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    import vo.run_recording"
    _write(tmp_path, "vo.frontend.orb", code)
    assert len(find_violations(tmp_path)) == 1


def test_a_cycle_is_found_also_inside_one_room(tmp_path: Path) -> None:
    _write(tmp_path, "vo.mapping.a", "from vo.mapping import b")
    _write(tmp_path, "vo.mapping.b", "def f():\n    import vo.mapping.c")
    _write(tmp_path, "vo.mapping.c", "from vo.mapping.a import thing")
    assert len(find_violations(tmp_path)) == 3


def test_a_type_only_import_makes_no_cycle(tmp_path: Path) -> None:
    _write(tmp_path, "vo.mapping.a", "from vo.mapping.b import thing")
    _write(tmp_path, "vo.mapping.b", "if TYPE_CHECKING:\n    from vo.mapping.a import other")
    assert find_violations(tmp_path) == []


def test_imports_that_follow_the_rules_pass(tmp_path: Path) -> None:
    _write(tmp_path, "vo.types", "import numpy")
    _write(tmp_path, "vo.backend.bundle_adjustment", "import gtsam\nfrom vo.types import Floats")
    _write(
        tmp_path,
        "vo.cli.app",
        "import typer\nfrom vo.run_recording import run\nimport data_synth.room",
    )
    _write(tmp_path, "data_synth.room", "from vo.geometry.cameras import project")
    assert find_violations(tmp_path) == []


def _write(root: Path, module: str, code: str) -> None:
    path = root.joinpath(*module.split(".")).with_suffix(".py")
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(code + "\n", encoding="utf-8")

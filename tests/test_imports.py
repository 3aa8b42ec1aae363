"""Which module may import which; imports inside functions count, relative ones are not used.

`vo/` consists of wings, a wing of rooms (packages and modules), and the rooms stand on floors.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]

# Which wing may import which other ones, or which rooms of them.
WINGS = {
    "vo.base": set(),
    "vo.engine": {"vo.base"},
    "vo.recordings": {"vo.base"},
    # Recordings come in and results go out in the same formats; neither side knows the other.
    "vo.outputs": {"vo.base", "vo.recordings.formats"},
    "vo.tools": {"vo.base", "vo.engine", "vo.recordings", "vo.outputs"},
    # Markers give the scale of a run; it knows no other tool.
    "vo.runs": {"vo.base", "vo.engine", "vo.recordings", "vo.outputs", "vo.tools.markers"},
    "vo.api": {
        *("vo.base", "vo.engine", "vo.recordings", "vo.outputs", "vo.tools", "vo.runs"),
        "data_synth",
    },
    "vo.cli": {
        *("vo.base", "vo.engine", "vo.recordings", "vo.outputs", "vo.tools", "vo.runs"),
        *("vo.api", "data_synth"),
    },
}
ENTRANCES = {
    # Type checkers see the public names, which are imported when they are first used.
    "vo": {"vo.base", "vo.engine", "vo.recordings", "vo.outputs", "vo.tools", "vo.api"},
    "vo.__main__": {"vo.cli"},
    "data_synth": {
        *("vo.base.errors", "vo.base.extras", "vo.base.types", "vo.base.settings"),
        "vo.base.section",
        *("vo.base.version", "vo.base.compiling", "vo.base.geometry", "vo.recordings.formats"),
    },
}
# Floors of each wing: a room imports from floors below its own, never from one beside it. A new
# room needs a place here; `api` and `cli` are one room each.
FLOORS: dict[str, tuple[set[str], ...]] = {
    "vo.base": (
        {"errors", "failures", "faults", "printable", "scheduling", "stopwatch", "version"}
        | {"compiling", "frozen", "option_names", "section"},
        {"files"},
        {"extras", "settings", "types"},
        {"feature_settings", "geometry", "images", "noise_classes", "records"},
        {"config"},
    ),
    "vo.engine": (
        {"geometry"},
        {"frontend"},
        {"learned"},
        {"mapping", "features", "markers"},
        {"places", "inertial"},
        {"tracking", "backend", "refinement", "maps", "loop_verification"},
        {"trajectory"},
        {"inertial_path"},
        {"frame_refit"},
        {"map_updater", "snapshot", "memory", "warmup"},
        {"map_creator"},
        {"map_alignment"},
        {"recovery"},
        {"odometry_base"},
        {"stages"},
        {"odometry"},
        {"rig"},
    ),
    "vo.recordings": ({"formats"}, {"sources"}),
    "vo.outputs": ({"evaluation", "recorders", "results", "streaming"}, {"report"}),
    "vo.tools": (
        {"drawing", "models", "reopening"},
        {"calibrating", "pairs"},
        {"dense", "inspection", "laboratory", "maps", "markers", "objects", "rendering"},
    ),
    "vo.runs": (
        {"inertial_checks", "interrupts", "pose_log", "progress", "scaling", "sensor_alignment"}
        | {"focal_adjustment", "keyframe_tracking"},
        {"run_options", "run_scale", "run_summary"},
        {"readout_estimation"},
        {"camera_estimation", "camera_poses", "readout", "zoom"},
        {"pair_estimation", "second_pass"},
        {"run_session"},
        {"run_recording"},
        {"batch"},
    ),
}
ONLY_IN = {"gtsam": "vo.engine.backend", "rerun": "vo.outputs.recorders", "typer": "vo.cli"}
BANNED_NAMES = {"utils", "util", "common", "helpers", "helper", "misc"}

RULE_CASES = (
    ("vo.base.types", "import vo.engine.places", "vo.base.types must not know vo.engine"),
    ("vo.base.types", "import vo.base.geometry", "vo.base.types must not know vo.base.geometry"),
    (
        "vo.engine.geometry.pnp",
        "from vo.recordings import formats",
        "vo.engine.geometry must not know vo.recordings.formats",
    ),
    (
        "vo.engine.frontend.orb",
        "import vo.recordings.sources",
        "vo.engine.frontend must not know vo.recordings.sources",
    ),
    (
        "vo.engine.odometry",
        "from vo.outputs.recorders import x",
        "vo.engine.odometry must not know vo.outputs.recorders",
    ),
    ("vo.engine.stages", "import vo.tools.maps", "vo.engine.stages must not know vo.tools.maps"),
    ("vo.engine.warmup", "import vo", "vo.engine.warmup must not know vo"),
    (
        "vo.engine.mapping.local_map",
        "import vo.engine.tracking.tracker",
        "vo.engine.mapping must not know vo.engine.tracking",
    ),
    (
        "vo.engine.tracking.tracker",
        "import vo.engine.backend.covariance",
        "vo.engine.tracking must not know vo.engine.backend",
    ),
    (
        "vo.engine.places.records",
        "import vo.engine.backend",
        "vo.engine.places must not know vo.engine.backend",
    ),
    (
        "vo.engine.trajectory.store",
        "import vo.engine.odometry",
        "vo.engine.trajectory must not know vo.engine.odometry",
    ),
    (
        "vo.recordings.sources.kitti",
        "import vo.engine.geometry",
        "vo.recordings.sources must not know vo.engine.geometry",
    ),
    (
        "vo.outputs.results.tables",
        "import vo.recordings.sources",
        "vo.outputs.results must not know vo.recordings.sources",
    ),
    (
        "vo.outputs.results.tables",
        "import vo.outputs.evaluation",
        "vo.outputs.results must not know vo.outputs.evaluation",
    ),
    ("vo.tools.maps.contents", "import vo.runs.batch", "vo.tools.maps must not know vo.runs.batch"),
    (
        "vo.runs.run_recording",
        "import vo.tools.objects",
        "vo.runs.run_recording must not know vo.tools.objects",
    ),
    ("vo.runs.run_recording", "import vo.cli.app", "vo.runs.run_recording must not know vo.cli"),
    ("vo.runs.batch.job", "import data_synth", "vo.runs.batch must not know data_synth"),
    ("vo.api.maps", "import vo.cli.app", "vo.api must not know vo.cli"),
    ("data_synth.room", "import vo.base.config", "data_synth must not know vo.base.config"),
)


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


def wing_of(module: str) -> str:
    """`vo.engine` for `vo.engine.frontend.orb`, `data_synth` for all of it."""
    parts = module.split(".")
    return "data_synth" if parts[0] == "data_synth" else ".".join(parts[:2])


def room_of(module: str) -> str:
    """`vo.engine.frontend` for `vo.engine.frontend.orb`, `vo.cli` for all of it."""
    wing = wing_of(module)
    return ".".join(module.split(".")[:3]) if wing in FLOORS else wing


def floor_of(room: str) -> int | None:
    """The floor of a room in its wing; -1 for the wing itself, None for a room without a place."""
    if room in FLOORS:
        return -1
    name = room.removeprefix(f"{wing_of(room)}.")
    found = (n for n, rooms in enumerate(FLOORS.get(wing_of(room), ())) if name in rooms)
    return next(found, None)


def may_import(room: str, target: str) -> bool:
    """Whether a room may import another one."""
    wing, target_wing = wing_of(room), wing_of(target)
    if wing == target_wing:
        floor, target_floor = floor_of(room), floor_of(target)
        return room == target or (
            floor is not None and target_floor is not None and target_floor < floor
        )
    return not {target, target_wing}.isdisjoint((WINGS | ENTRANCES).get(wing, set()))


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
        room, wing = room_of(name), wing_of(name)
        is_known = wing in WINGS | ENTRANCES and (wing not in FLOORS or floor_of(room) is not None)
        if not is_known:
            lines.append(f"{name}: room {room} has no rule in {Path(__file__).name}")
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
        if not may_import(room, target):
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


def test_the_package_is_a_table_of_contents() -> None:
    """Only wings, and the two modules that enter them; a new wing needs a line in `WINGS`."""
    found = {path.relative_to(ROOT / "vo").parts[0] for path in (ROOT / "vo").rglob("*.py")}
    assert found == {wing.removeprefix("vo.") for wing in WINGS} | {"__init__.py", "__main__.py"}


def test_every_room_on_a_floor_is_there() -> None:
    modules = find_modules(ROOT)
    places = [f"{wing}.{room}" for wing in FLOORS for rooms in FLOORS[wing] for room in rooms]
    assert [place for place in places if place not in modules] == []
    assert len(places) == len(set(places))


@pytest.mark.parametrize(
    ("module", "code", "complaint"),
    [
        ("vo.engine.mapping.local_map", "import gtsam", "only vo.engine.backend may"),
        ("vo.runs.run_recording", "from rerun.blueprint import Grid", "only vo.outputs.recorders"),
        ("vo.runs.run_recording", "import typer", "only vo.cli may"),
        ("vo.engine.mapping.local_map", "from . import x", "relative imports hide the room"),
        ("vo.engine.mapping.utils", "", "a module's name says what it owns"),
        ("vo.engine.newroom.thing", "", "room vo.engine.newroom has no rule"),
        ("vo.newwing.thing", "", "room vo.newwing has no rule"),
        *RULE_CASES,
    ],
)
@pytest.mark.parametrize(
    "form", ["{}", "def f():\n    {}", "try:\n    {}\nexcept ImportError:\n    pass"]
)
def test_a_broken_rule_is_found(
    tmp_path: Path, module: str, code: str, complaint: str, form: str
) -> None:
    _write(tmp_path, "vo.recordings.formats", "")
    _write(tmp_path, module, form.format(code or "pass"))
    violations = find_violations(tmp_path)
    assert len(violations) == 1
    assert complaint in violations[0]


@pytest.mark.parametrize("target", ["vo.runs.run_recording", "vo.recordings.formats"])
def test_a_type_only_import_of_another_wing_is_found(tmp_path: Path, target: str) -> None:
    code = f"from typing import TYPE_CHECKING\nif TYPE_CHECKING:\n    import {target}"
    _write(tmp_path, "vo.engine.frontend.orb", code)
    assert len(find_violations(tmp_path)) == 1


def test_a_cycle_is_found_also_inside_one_room(tmp_path: Path) -> None:
    _write(tmp_path, "vo.engine.mapping.a", "from vo.engine.mapping import b")
    _write(tmp_path, "vo.engine.mapping.b", "def f():\n    import vo.engine.mapping.c")
    _write(tmp_path, "vo.engine.mapping.c", "from vo.engine.mapping.a import thing")
    assert len(find_violations(tmp_path)) == 3


def test_a_type_only_import_makes_no_cycle(tmp_path: Path) -> None:
    code = "if TYPE_CHECKING:\n    from vo.engine.mapping.a import other"
    _write(tmp_path, "vo.engine.mapping.a", "from vo.engine.mapping.b import thing")
    _write(tmp_path, "vo.engine.mapping.b", code)
    assert find_violations(tmp_path) == []


def test_imports_that_follow_the_rules_pass(tmp_path: Path) -> None:
    _write(tmp_path, "vo.base.types", "import numpy")
    _write(tmp_path, "vo.engine.backend.bundle_adjustment", "import gtsam\nimport vo.base.types")
    _write(tmp_path, "vo.runs.scaling.fit", "import vo.tools.markers.marker_map")
    _write(
        tmp_path,
        "vo.cli.app",
        "import typer\nfrom vo.runs.run_recording import run\nimport data_synth.room",
    )
    _write(tmp_path, "data_synth.room", "from vo.base.geometry.cameras import project")
    assert find_violations(tmp_path) == []


def _write(root: Path, module: str, code: str) -> None:
    path = root.joinpath(*module.split(".")).with_suffix(".py")
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(code + "\n", encoding="utf-8")

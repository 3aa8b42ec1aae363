"""The examples for clusters in docs/cluster: their syntax, and the commands in them."""

from __future__ import annotations

import shlex
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import yaml
from typer.main import get_command

from vo.cli.app import app

CLUSTER = Path(__file__).resolve().parents[3] / "docs" / "cluster"


def check_command(words: list[str]) -> None:
    """Refuse a `vo batch` whose options do not exist."""
    assert words[:2] == ["vo", "batch"]
    command: Any = get_command(app)
    command.commands["batch"].make_context("batch", list(words[2:]))


def kuberay() -> dict[str, Any]:
    return yaml.safe_load((CLUSTER / "kuberay.yaml").read_text())


def test_the_slurm_script_starts_ray_and_the_batch_with_options_that_exist() -> None:
    ray = pytest.importorskip("ray.scripts.symmetric_run", reason="ray is not installed")
    script = CLUSTER / "slurm.sh"
    subprocess.run(["bash", "-n", script], check=True)
    text = script.read_text().replace("\\\n", " ")
    line = next(each for each in text.splitlines() if each.startswith("srun"))
    words = shlex.split(line)
    split = words.index("--")
    check_command(words[split + 1 :])
    own = {option for each in ray.symmetric_run.params for option in each.opts}
    asked = [word for word in words[:split] if word.startswith("--")]
    assert [word for word in asked if word not in own] == ["--num-cpus"]
    start = subprocess.run(
        [Path(sys.executable).with_name("ray"), "start", "--help"], capture_output=True, text=True
    )
    assert "--num-cpus" in start.stdout


def test_the_job_of_kuberay_runs_a_batch_on_its_workers() -> None:
    job = kuberay()
    assert (job["apiVersion"], job["kind"]) == ("ray.io/v1", "RayJob")
    check_command(shlex.split(job["spec"]["entrypoint"]))
    cluster = job["spec"]["rayClusterSpec"]
    head, (workers,) = cluster["headGroupSpec"], cluster["workerGroupSpecs"]
    assert head["rayStartParams"]["num-cpus"] == "0"
    assert workers["minReplicas"] <= workers["replicas"] <= workers["maxReplicas"]
    for group in (head, workers):
        spec = group["template"]["spec"]
        volumes = {volume["name"] for volume in spec["volumes"]}
        for container in spec["containers"]:
            assert {mount["name"] for mount in container["volumeMounts"]} <= volumes
            assert container["image"] == head["template"]["spec"]["containers"][0]["image"]

"""The rendered walk, and its runs with two cameras and with one."""

from __future__ import annotations

import pytest
from recorded_walk import Recording, Run, rendered_recording, track


@pytest.fixture(scope="package")
def recording() -> Recording:
    return rendered_recording()


@pytest.fixture(scope="package")
def stereo(recording: Recording) -> Run:
    return track(recording.rig, recording.frames, takes_snapshots=True)


@pytest.fixture(scope="package")
def mono(recording: Recording) -> Run:
    return track(recording.mono_rig, recording.mono())

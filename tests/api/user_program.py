"""A user's program with the whole Python interface, for `mypy --strict`; it is not run."""

from __future__ import annotations

from pathlib import Path

import numpy as np

import vo


def commands(folder: Path) -> None:
    recording: Path = vo.synth(folder / "walk", "demo", seconds=3.0, mono=True, effects="blur=2")
    found = vo.info(recording, mode="mono", topics=["/left"], picture=folder / "sheet.png")
    print(found.path, found.command, [each.what for each in found.findings])
    small: Path = vo.convert(recording, folder / "small", resize="0.5", start=3, to="euroc")
    summary: vo.Summary = vo.run(
        small,
        folder / "out",
        "fast",
        overrides=["features.count=900"],
        mode="mono",
        height=1.65,
        mask=folder / "body.png",
        ignore=["0,0,9,9"],
        markers=0.16,
        gps="gps.nmea",
        wheel="wheel.csv",
        save_calibration=folder / "estimated.yaml",
        georeference=True,
        lever_arm=(0.0, 0.1, 0.2),
        imu=False,
        loops=True,
        save_map=folder / "house.map",
        mcap=folder / "run.mcap",
        poses=["udp://localhost:9000"],
    )
    print(summary.verdict.word, vo.evaluate(folder / "out", small).ate.translation.rmse)
    errors = vo.evaluate("log.mcap", small, topics=["estimate=/odom"], picture="errors.png")
    print(errors.ate.translation.rmse)
    page: Path = vo.report([folder / "out"], truth=None, images=False)
    print(vo.video(folder / "out", small, folder / "run.mp4", speed=2.0).images)
    vo.print_board(folder / "board.pdf", board="charuco", columns=7, rows=5, square=0.02)
    cameras = vo.calibrate(folder / "board", board="charuco", square=0.02, picture="seen.png")
    lens = cameras.rig.cam0
    sensor = vo.calibrate_imu(folder / "swing", folder / "imu.yaml", calibration="camera.yaml")
    noise = vo.calibrate_imu_noise(folder / "rest", picture="allan.png").noise
    print(sensor.imu.cam0_from_imu, sensor.found.time_offset_s, noise.gyro_noise)
    result = vo.batch([recording, small], folder / "all", jobs=2, report=True, memory_mb=4000)
    vo.batch("s3://bucket/drives/", folder / "all", ray="auto", threads=4)
    print(page, lens.fx, [each.name for each in result.unfinished])
    vo.run(small, folder / "out", heigth=1.65)  # type: ignore[call-arg]
    vo.run(small, folder / "out", end="5")  # type: ignore[arg-type]
    vo.batch(small, folder / "b", memory="4")  # type: ignore[call-arg]
    vo.print_board(folder / "b.pdf", look_at=3)  # type: ignore[call-arg]
    vo.convert(small, folder / "b", too="kitti")  # type: ignore[call-arg]


def pictures(folder: Path, image: np.ndarray[tuple[int, int], np.dtype[np.uint8]]) -> None:
    pair = vo.match(image, "b.png", picture=folder / "p.png", best=20, ignore="0,0,9,9", ratio=0.8)
    if pair.fit is not None and pair.pose is not None:
        print(pair.fit.matrix[2, 2], pair.pose.second_from_first, pair.inlier.sum())
    counts = vo.match_folder(folder, window=5, pairs=[("a.png", "b.png")], output=folder / "m.db")
    print([(each.image_a, each.inliers, each.model) for each in counts])
    rows = vo.features.compare("walk/", ["orb", "klt"], gaps=(1, 5), picture="methods.png")
    planes = vo.features.compare_planes("v_boat/", "sift")
    print(rows[0].precision, planes[0].within_3_px, vo.features.create("sift").detect(image).xy)
    for marker in vo.find_markers(image, 0.16, calibration="camera.yaml", dictionary="tag36h11"):
        if marker.pose is not None:
            print(marker.id, marker.pose.distance_m, marker.pose.is_ambiguous)
    print(vo.panorama([image, "b.png"], flat=True).shape)
    cloud: vo.Densified = vo.dense(folder / "out", options=vo.DenseOptions())
    print(cloud, vo.render(folder / "out", "model.obj", folder / "ar"))
    objects = vo.ObjectDatabase.load(folder / "objects.npz")
    objects.learn("bust", folder / "out", radius=0.4)
    print([(each.name, each.inliers) for each in objects.find(image)])
    vo.match(image, image, colour="hsv")  # type: ignore[arg-type]
    vo.match_folder(folder, right=True)  # type: ignore[call-arg]


def saved(folder: Path) -> None:
    left: vo.Trajectory = vo.read_trajectory(folder / "path.tum")
    vo.write_trajectory(folder / "copy.tum", left)
    merged = vo.maps.merge(folder / "a.map", folder / "b.map", folder / "both.map")
    print(merged, vo.maps.load(folder / "both.map"), vo.maps.info(folder / "both.map")["keyframes"])
    recording: vo.Recording = vo.open(folder / "walk", mode="stereo")
    for frame in recording.frames(0, 5):
        print(frame.stamp_ns, frame.image0.shape)


def frames(images: list[np.ndarray[tuple[int, int], np.dtype[np.uint8]]]) -> vo.Trajectory:
    words = vo.ImuCalibration(np.eye(4), vo.ImuNoise(1e-3, 1e-5, 1e-2, 1e-4), 0.01)
    with vo.Odometry(
        "camera.yaml", mode="mono", imu=words, map="house.map", localize=True, mask=["body.png"]
    ) as odometry:
        for number, image in enumerate(images):
            odometry.add_imu(number * 50_000_000 + 1, (0.0, 0.0, 0.1), np.array([0.0, 9.8, 0.0]))
            ahead: vo.PredictedPose | None = odometry.predict(number * 50_000_000)
            if ahead is not None and ahead.covariance is not None:
                print(ahead.world_from_cam0[:3, 3], ahead.covariance.trace())
            estimate: vo.Estimate = odometry.track(number * 50_000_000, image)
            if estimate.state.has_pose and estimate.position is not None:
                print(estimate, estimate.position[0])
            elif estimate.failure is not None:
                print(str(estimate.failure).upper())
        vo.Odometry("camera.yaml", localise=True)  # type: ignore[call-arg]
        return odometry.trajectory()

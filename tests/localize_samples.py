"""Small beliefs and runs that several tests of the filter build on."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from pipelines.artifacts.arrays import FloatArray
from pipelines.geometry.camera import Camera
from pipelines.geometry.pose import base_from_camera_mount
from pipelines.localize.belief import Belief, gaussian_belief, normalise_log_weights
from pipelines.localize.run import FrameRecord, Run
from pipelines.localize.state_space import PLANAR, SPATIAL

CAMERA = Camera("SIMPLE_PINHOLE", 64, 48, (60.0, 31.5, 23.5))


def weighted(states: Sequence[Sequence[float]], weights: Sequence[float]) -> Belief:
    """A belief from states and weights of any sum; zero weights are allowed."""
    with np.errstate(divide="ignore"):
        log_weights, _ = normalise_log_weights(np.log(np.asarray(weights, dtype=np.float64)))
    return Belief(np.asarray(states, dtype=np.float64), log_weights)


def frame_record(
    timestamp: float,
    estimates: Mapping[str, FloatArray],
    seed: int = 0,
    particles: int = 30,
    seconds: Mapping[str, float] | None = None,
) -> FrameRecord:
    """A frame whose particles lie around (1, 2, 0.5)."""
    belief = gaussian_belief(
        PLANAR, (1.0, 2.0, 0.5), 0.1, 0.05, particles, np.random.default_rng(seed)
    )
    return FrameRecord(
        timestamp=timestamp,
        image_name=f"rgb/{timestamp:.1f}.png",
        particles=belief.states,
        log_weights=belief.log_weights,
        estimates=dict(estimates),
        modes=np.array([[1.0, 2.0, 0.5, 0.9], [4.0, 2.0, 0.5, 0.1]]),
        covariance=np.diag([0.01, 0.01, 0.0025]),
        effective_sample_size=float(particles),
        confidence=0.7,
        status="tracking" if estimates else "lost",
        seconds={"prepare": 0.25, "likelihood": 0.5} if seconds is None else seconds,
    )


def run_along(
    states: FloatArray,
    groundtruth: FloatArray | None = None,
    odometry: FloatArray | None = None,
    timestamps: FloatArray | None = None,
) -> Run:
    """A run whose ``mode`` estimates are ``states`` ``(N, 3)``; frames at NaN states have none."""
    times = 0.5 * np.arange(len(states)) if timestamps is None else timestamps
    frames = tuple(
        frame_record(
            float(time),
            {} if np.any(np.isnan(state)) else {"mode": state, "max_weight": state + 0.01},
            seed=index,
        )
        for index, (time, state) in enumerate(zip(times, states, strict=True))
    )
    return Run(
        scene_identifier="5ce7e",
        scene_path="scene.h5",
        dataset_name="lobby",
        camera=CAMERA,
        base_from_camera=base_from_camera_mount((0.1, 0.0, 0.6), (0.0, 5.0, 0.0)),
        settings={"particles": 30, "strategy": "annealed"},
        seed=7,
        frames=frames,
        encoded_images=tuple(b"image %d" % index for index in range(len(frames))),
        odometry=odometry,
        groundtruth=groundtruth,
    )


def curved_path(count: int) -> FloatArray:
    """``(count, 3)`` states along a bend that crosses the heading pi."""
    time = np.linspace(0.0, 1.0, count)
    heading = 2.6 + 1.2 * time
    return np.stack(
        [3.0 * time, 1.0 - 2.0 * time**2, np.arctan2(np.sin(heading), np.cos(heading))], axis=1
    )


def spatial_path(count: int) -> FloatArray:
    """``(count, 6)`` poses of a camera in the hand that turns about all axes."""
    time = np.linspace(0.0, 1.0, count)
    turns = np.stack([0.3 * np.sin(3.0 * time), 1.5 + 0.2 * time, 2.0 * time - 1.0], axis=1)
    return np.concatenate([np.stack([time, 0.5 - time, 1.4 + 0.1 * time], axis=1), turns], axis=1)


def spatial_run(count: int) -> Run:
    """A run with six degrees of freedom whose estimates are ``spatial_path``; exact odometry."""
    states = spatial_path(count)
    planar = run_along(curved_path(count))
    rng = np.random.default_rng(8)
    frames = []
    for frame, state in zip(planar.frames, states, strict=True):
        belief = gaussian_belief(SPATIAL, state, 0.1, 0.05, 30, rng)
        frames.append(
            replace(
                frame,
                particles=belief.states,
                log_weights=belief.log_weights,
                estimates={"mode": state, "refined": state},
                modes=np.array([[*state, 0.9], [*(state + 0.5), 0.1]]),
                covariance=np.diag([0.01] * 3 + [0.0025] * 3),
                refined_covariance=np.diag([1e-4] * 3 + [1e-5] * 3),
            )
        )
    poses = SPATIAL.poses(states)
    own = np.stack([SPATIAL.increment(poses[0], pose) for pose in poses])
    return replace(planar, frames=tuple(frames), base_from_camera=np.eye(4), odometry=own)

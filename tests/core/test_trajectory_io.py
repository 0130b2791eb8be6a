"""Trajectory files: nothing is lost, errors name file and line, evo and GTSAM agree."""

from __future__ import annotations

from pathlib import Path

import gtsam
import numpy as np
import pytest
from evo.core.trajectory import PoseTrajectory3D
from evo.tools import file_interface

from fgloc.core.trajectory import Trajectory
from fgloc.core.trajectory_g2o import relative_information
from fgloc.core.trajectory_io import load_trajectory, save_trajectory
from fgloc.errors import FglocError

SUFFIXES = (".tum", ".txt", ".kitti", ".g2o", ".npz")


def wild(n: int = 200) -> Trajectory:
    """Return a trajectory with awkward numbers: late stamps, many turns, tiny and huge values."""
    rng = np.random.default_rng(1)
    stamps = 1_714_764_874_822_971_396 + np.cumsum(rng.integers(1, 10**8, n))
    steps = rng.normal(size=(n, 3)) * [0.1, 0.1, 0.8]
    poses = np.cumsum(steps, axis=0) + np.array([0.1, 1 / 3, 40.0])
    poses[0, :2] = 1e-300, -123456.789012345
    poses[1, :2] = 5e-324, 0.1 + 0.2
    a = rng.normal(size=(n, 3, 3))
    covariances = a @ a.transpose(0, 2, 1)
    return Trajectory(stamps, poses, (covariances + covariances.transpose(0, 2, 1)) / 2)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_round_trip(tmp_path: Path, suffix: str) -> None:
    before = wild()
    path = tmp_path / f"run{suffix}"
    save_trajectory(before, path)
    after = load_trajectory(path)
    np.testing.assert_array_equal(after.stamps_ns, before.stamps_ns)
    np.testing.assert_array_equal(after.poses[:, :2], before.poses[:, :2])
    if suffix in (".g2o", ".npz"):
        np.testing.assert_array_equal(after.poses[:, 2], before.poses[:, 2])
        np.testing.assert_array_equal(after.covariances, before.covariances)
    else:
        # Through sine and cosine: equal to rounding, whole turns included.
        np.testing.assert_allclose(after.poses[:, 2], before.poses[:, 2], rtol=0, atol=4e-14)
        assert after.covariances is None


@pytest.mark.parametrize("suffix", SUFFIXES)
@pytest.mark.parametrize("stamp", [-1, -1_500_000_000, 0, 7, 2**62 + 1])
def test_stamps_survive_to_the_nanosecond(tmp_path: Path, suffix: str, stamp: int) -> None:
    path = tmp_path / f"run{suffix}"
    save_trajectory(Trajectory(np.array([stamp]), np.zeros((1, 3))), path)
    assert load_trajectory(path).stamps_ns.tolist() == [stamp]


def test_tum_text_by_hand(tmp_path: Path) -> None:
    # Headings 0 and 180°; 2³¹ s + 5 ns is a stamp that a double would round to 0 ns.
    path = tmp_path / "a.tum"
    poses = np.array([[0.1, -2.0, 0.0], [1e-7, 3.0, np.pi]])
    save_trajectory(Trajectory(np.array([-1_500_000_000, 2**31 * 10**9 + 5]), poses), path)
    lines = path.read_text().splitlines()
    assert lines[1] == "-1.500000000 0.1 -2.0 0.0 0.0 0.0 0.0 1.0"
    assert lines[2] == "2147483648.000000005 1e-07 3.0 0.0 0.0 0.0 1.0 6.123233995736766e-17"


def test_evo_reads_our_tum(tmp_path: Path) -> None:
    before = wild()
    save_trajectory(before, tmp_path / "a.tum")
    theirs = file_interface.read_tum_trajectory_file(tmp_path / "a.tum")
    np.testing.assert_array_equal(theirs.positions_xyz[:, :2], before.poses[:, :2])
    np.testing.assert_allclose(theirs.timestamps, before.stamps_ns * 1e-9, rtol=1e-15)
    rotations = np.array(theirs.poses_se3)[:, :2, :2]
    c, s = np.cos(before.poses[:, 2]), np.sin(before.poses[:, 2])
    np.testing.assert_allclose(rotations.reshape(-1, 4), np.stack([c, -s, s, c], -1), atol=1e-13)


def test_we_read_evos_tum_and_kitti(tmp_path: Path) -> None:
    # evo writes stamps in scientific notation with 19 digits of the double.
    rng = np.random.default_rng(2)
    heading = np.cumsum(rng.normal(size=30))
    heading = (heading + np.pi) % (2 * np.pi) - np.pi
    xyz = np.column_stack([rng.normal(size=(30, 2)), np.zeros(30)])
    zero = np.zeros(30)
    quaternions = np.column_stack([np.cos(heading / 2), zero, zero, np.sin(heading / 2)])
    stamps = np.arange(30) * 0.25 + 1e9
    theirs = PoseTrajectory3D(xyz, quaternions, stamps)
    file_interface.write_tum_trajectory_file(str(tmp_path / "a.tum"), theirs)
    file_interface.write_kitti_poses_file(str(tmp_path / "a.kitti"), theirs)
    tum, kitti = load_trajectory(tmp_path / "a.tum"), load_trajectory(tmp_path / "a.kitti")
    np.testing.assert_array_equal(tum.stamps_ns, 10**18 + 250_000_000 * np.arange(30))
    np.testing.assert_array_equal(kitti.stamps_ns, 10**9 * np.arange(30))
    for ours in (tum, kitti):
        np.testing.assert_allclose(ours.poses[:, :2], xyz[:, :2], rtol=1e-15)
        np.testing.assert_allclose(ours.poses[:, 2], np.unwrap(heading), atol=1e-13)


def test_evo_reads_our_kitti(tmp_path: Path) -> None:
    before = wild()
    save_trajectory(before, tmp_path / "a.kitti")
    theirs = np.array(file_interface.read_kitti_poses_file(tmp_path / "a.kitti").poses_se3)
    np.testing.assert_array_equal(theirs[:, :2, 3], before.poses[:, :2])
    np.testing.assert_allclose(theirs[:, 1, 0], np.sin(before.poses[:, 2]), atol=1e-15)


def test_gtsam_reads_our_g2o(tmp_path: Path) -> None:
    before = wild(20)
    save_trajectory(before, tmp_path / "a.g2o")
    graph, values = gtsam.readG2o(str(tmp_path / "a.g2o"))
    assert graph.size() == 19
    assert values.size() == 20
    for k in range(20):
        x, y, theta = before.poses[k]
        assert values.atPose2(k).equals(gtsam.Pose2(x, y, theta), 1e-9)
    # The steps are those between the vertices, so no edge pulls.
    assert graph.error(values) == pytest.approx(0.0, abs=1e-9)
    noise = graph.at(3).noiseModel()
    np.testing.assert_allclose(noise.information(), relative_information(before)[3], rtol=1e-9)


def test_relative_information_by_sampling() -> None:
    # Two poses with independent errors: the error of the step, as g2o and GTSAM measure it.
    rng = np.random.default_rng(3)
    poses = np.array([[1.0, 2.0, 0.4], [1.5, 2.8, 1.1]])
    a = rng.normal(size=(2, 3, 3)) * 0.003
    covariances = a @ a.transpose(0, 2, 1)
    ours = np.linalg.inv(relative_information(Trajectory(np.array([0, 1]), poses, covariances))[0])
    draws = [rng.multivariate_normal(p, c, 4000) for p, c in zip(poses, covariances, strict=True)]
    step = gtsam.Pose2(*poses[0]).between(gtsam.Pose2(*poses[1]))
    errors = np.array(
        [
            step.localCoordinates(gtsam.Pose2(*p).between(gtsam.Pose2(*q)))
            for p, q in zip(*draws, strict=True)
        ]
    )
    sigma = np.sqrt(np.diag(ours))
    # 4000 samples: a correlation or relative variance is good to about 2/sqrt(4000) = 3 %.
    np.testing.assert_allclose(
        np.cov(errors.T) / np.outer(sigma, sigma), ours / np.outer(sigma, sigma), atol=0.1
    )


def test_edges_are_identity_without_covariances(tmp_path: Path) -> None:
    path = tmp_path / "a.g2o"
    save_trajectory(Trajectory(np.array([0, 1]), np.array([[0.0, 0, 0], [2.0, 0, 0]])), path)
    lines = path.read_text().splitlines()
    assert "EDGE_SE2 0 1 2 0 0 1 0 0 1 0 1" in lines
    assert "FIX 0" in lines


def test_foreign_g2o_is_ordered_by_id_and_unwrapped(tmp_path: Path) -> None:
    path = tmp_path / "a.g2o"
    path.write_text(
        "VERTEX_SE2 7 1 0 -3.0\nVERTEX_XY 9 4 4\nVERTEX_SE2 5 0 0 3.0\nEDGE_SE2_XY 5 9 1 1 1 0 1\n"
    )
    ours = load_trajectory(path)
    np.testing.assert_allclose(ours.poses, [[0, 0, 3.0], [1, 0, 2 * np.pi - 3.0]], atol=1e-15)
    assert ours.stamps_ns.tolist() == [0, 10**9]


def test_headings_are_unwrapped_across_the_file(tmp_path: Path) -> None:
    # Three turns in steps of 30°, written by someone who knows nothing of turns.
    heading = np.radians(np.arange(0, 1081, 30.0))
    half = heading / 2
    lines = [
        f"{k} 0 0 0 0 0 {s!r} {c!r}"
        for k, (s, c) in enumerate(zip(np.sin(half).tolist(), np.cos(half).tolist(), strict=True))
    ]
    path = tmp_path / "a.tum"
    path.write_text("# by hand\n\n" + "\n".join(lines))
    np.testing.assert_allclose(load_trajectory(path).poses[:, 2], heading, atol=1e-12)


def test_a_slightly_tilted_pose_is_projected_to_its_yaw(tmp_path: Path) -> None:
    # Yaw 40°, then roll 6° about the body's own x axis: x keeps pointing to 40°. Twice as long
    # a quaternion is the same rotation.
    yaw, roll = np.radians(40.0) / 2, np.radians(6.0) / 2
    qx, qy = np.cos(yaw) * np.sin(roll), np.sin(yaw) * np.sin(roll)
    qz, qw = np.sin(yaw) * np.cos(roll), np.cos(yaw) * np.cos(roll)
    path = tmp_path / "a.tum"
    text = " ".join(repr(float(2 * q)) for q in (qx, qy, qz, qw))
    path.write_text(f"0 1 2 0.3 {text}\n")
    np.testing.assert_allclose(load_trajectory(path).poses, [[1, 2, np.radians(40)]], atol=1e-15)


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("a.tum", "0 0 0 0 0 0 0 1\n1 0 0 0 0 0 1\n", "a.tum:2: 7 columns where 8 belong"),
        ("a.tum", "# x\n\n0 0 nan 0 0 0 0 1\n", "a.tum:3: nan is not finite"),
        ("a.tum", "0 0 0 0 0 0 0 1\n1 0 b 0 0 0 0 1\n", "a.tum:2: 'b' is not a number"),
        ("a.tum", "0 0 0 0 0 0 0 1\n0 0 0 0 0 0 0 1\n", "a.tum:2: the stamp does not come after"),
        ("a.tum", "2 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 1\n", "a.tum:2: the stamp does not come after"),
        ("a.tum", "NaN 0 0 0 0 0 0 1\n", "a.tum:1: 'NaN' is not a time"),
        ("a.tum", "1e99999 0 0 0 0 0 0 1\n", "a.tum:1: '1e99999' is not a time"),
        ("a.tum", "0 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 0\n", "a.tum:2: the quaternion has norm zero"),
        ("a.tum", "0 0 0 0 0.5 0 0 0.866\n", "a.tum:1: the pose is tilted by 60.0°"),
        ("a.tum", "# only a comment\n", "a.tum: holds no poses"),
        ("a.tum", "# turns: x\n0 0 0 0 0 0 0 1\n", "is not a number of turns"),
        ("a.kitti", "1 0 0 0 0 1 0 0 0 0 1\n", "a.kitti:1: 11 columns where 12 belong"),
        ("a.kitti", "1 0 0 0 0 1 0 0 0 0 1 inf\n", "a.kitti:1: inf is not finite"),
        ("a.kitti", "2 0 0 0 0 1 0 0 0 0 1 0\n", "a.kitti:1: the 3x3 part"),
        ("a.kitti", "1 0 0 0 0 -1 0 0 0 0 1 0\n", "a.kitti:1: the 3x3 part"),
        ("a.kitti", "0 0 1 0 0 1 0 0 -1 0 0 0\n", "a.kitti:1: the pose is tilted by 90.0°"),
        ("a.g2o", "VERTEX_SE2 0 0 0\n", "a.g2o:1: 4 columns where 5 belong"),
        ("a.g2o", "VERTEX_SE2 0 0 0 nan\n", "a.g2o:1: nan is not finite"),
        ("a.g2o", "VERTEX_SE2 0.5 0 0 0\n", "a.g2o:1: '0.5' is not an integer"),
        ("a.g2o", "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 0 1 0 0\n", "a.g2o:2: vertex 0 stands twice"),
        ("a.g2o", "VERTEX_SE2 0 0 0 0\nEDGE_SE2 0 1 1 0\n", "a.g2o:2: 5 columns where 12"),
        ("a.g2o", "VERTEX_SE3:QUAT 0 0 0 0 0 0 0 1\n", "holds no VERTEX_SE2"),
        (
            "a.g2o",
            "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 0 0 0\n# STAMP_NS 0 5\n",
            "a.g2o: the STAMP_NS lines do not name each vertex once",
        ),
        (
            "a.g2o",
            "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 0 0 0\n# STAMP_NS 1 5\n# STAMP_NS 0 5\n",
            "a.g2o:3: the stamp does not come after",
        ),
        ("a.npz", "PK not really", "a.npz: is not an npz file"),
        ("a.csv", "0,0,0", "a.csv: unknown trajectory format; name the file .tum"),
    ],
)
def test_a_bad_file_is_one_line_with_file_and_line(
    tmp_path: Path, name: str, text: str, message: str
) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(FglocError) as caught:
        load_trajectory(tmp_path / name)
    assert message in str(caught.value)
    assert str(caught.value).startswith(str(tmp_path / name))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_missing_file(tmp_path: Path, suffix: str) -> None:
    with pytest.raises(FglocError, match="no such file; check the path"):
        load_trajectory(tmp_path / f"none{suffix}")


def test_kitti_stamps_must_fit_the_poses(tmp_path: Path) -> None:
    save_trajectory(wild(5), tmp_path / "a.kitti")
    side = tmp_path / "a.times"
    side.write_text("".join(side.read_text().splitlines(keepends=True)[:-1]))
    with pytest.raises(FglocError, match=r"a\.times: 4 stamps for the 5 poses of a\.kitti"):
        load_trajectory(tmp_path / "a.kitti")


def test_npz_content_is_checked(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    good = {"version": 1, "stamps_ns": np.array([0, 1]), "poses": np.zeros((2, 3))}

    def refuse(message: str, **changed: object) -> None:
        arrays = {k: v for k, v in (good | changed).items() if v is not None}
        np.savez(path, **arrays)  # type: ignore[arg-type]
        with pytest.raises(FglocError, match=message) as caught:
            load_trajectory(path)
        assert str(caught.value).startswith(str(path))

    refuse("is no trajectory: version missing", version=None)
    refuse("has version 2, this program reads 1", version=2)
    refuse("is no trajectory: poses missing", poses=None)
    refuse("poses must be float64, not float32", poses=np.zeros((2, 3), np.float32))
    refuse("must strictly increase", stamps_ns=np.array([1, 1]))
    refuse("needs int64 stamps", stamps_ns=np.array([0.0, 1.0]))
    refuse("not finite", poses=np.full((2, 3), np.nan))
    refuse("is not an npz file of plain arrays", poses=np.array([{}, {}], dtype=object))
    np.save(tmp_path / "b.npy", np.zeros(3))
    (tmp_path / "b.npy").rename(path)
    with pytest.raises(FglocError, match="is not an npz file"):
        load_trajectory(path)


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_nothing_is_left_behind_by_a_save_that_fails(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"a{suffix}"
    path.mkdir()
    with pytest.raises(FglocError):
        save_trajectory(wild(3), path)
    assert [p.name for p in tmp_path.iterdir()] == [path.name]


def test_saving_no_poses_or_an_unknown_format_is_refused(tmp_path: Path) -> None:
    empty = Trajectory(np.zeros(0, dtype=np.int64), np.zeros((0, 3)))
    with pytest.raises(FglocError, match="without poses cannot be written"):
        save_trajectory(empty, tmp_path / "a.tum")
    with pytest.raises(FglocError, match="unknown trajectory format"):
        save_trajectory(wild(3), tmp_path / "a.bag")
    assert list(tmp_path.iterdir()) == []

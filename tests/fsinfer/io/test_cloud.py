import logging
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from fsinfer.errors import CloudError
from fsinfer.io.chunks import ChunkSettings, open_chunks
from fsinfer.io.cloud import PointCloud, read_cloud, write_cloud
from fsinfer.io.las_writing import copy_las, las_writer
from tests.support.places import DATA

CLOUDS = DATA / "clouds"


def make_cloud(count: int = 500, offset: tuple[float, float, float] = (0.0, 0.0, 0.0), seed: int = 0) -> PointCloud:
    rng = np.random.default_rng(seed)
    normals = rng.normal(size=(count, 3))
    return PointCloud(
        xyz=rng.uniform(0, 20, (count, 3)) + offset,
        rgb=rng.integers(0, 256, (count, 3), dtype=np.uint8),
        normals=(normals / np.linalg.norm(normals, axis=1, keepdims=True)).astype(np.float32),
        extra={
            "TreeID": rng.integers(-1, 40, count).astype(np.int32),
            "confidence": rng.uniform(size=count).astype(np.float32),
            "views": rng.integers(1, 9, count),
        },
    )


@pytest.mark.parametrize("suffix", [".ply", ".las", ".laz"])
@pytest.mark.parametrize("offset", [(0.0, 0.0, 0.0), (5_423_117.25, 612_345.5, 431.0)])
def test_round_trip_keeps_points_colours_normals_and_extra_values(
    tmp_path: Path, suffix: str, offset: tuple[float, float, float]
) -> None:
    cloud = make_cloud(offset=offset)
    path = tmp_path / f"cloud{suffix}"
    write_cloud(path, cloud)
    back = read_cloud(path)
    np.testing.assert_allclose(back.xyz, cloud.xyz, rtol=0, atol=0.51e-4)
    np.testing.assert_array_equal(back.rgb, cloud.rgb)
    assert back.normals is not None
    assert cloud.normals is not None
    np.testing.assert_allclose(back.normals, cloud.normals, atol=1e-6)
    assert set(back.extra) == set(cloud.extra)
    for name, values in cloud.extra.items():
        np.testing.assert_array_equal(back.extra[name], values)
    assert back.extra["TreeID"].dtype == np.int32
    assert back.extra["confidence"].dtype == np.float32
    assert [p.name for p in tmp_path.iterdir()] == [path.name]


def test_las_stores_sixteen_bit_colour_and_reads_eight_bit_colour(tmp_path: Path) -> None:
    import laspy

    cloud = make_cloud(20)
    write_cloud(tmp_path / "c.laz", cloud)
    raw = laspy.read(tmp_path / "c.laz")
    assert cloud.rgb is not None
    np.testing.assert_array_equal(np.asarray(raw.red), cloud.rgb[:, 0].astype(np.uint16) * 257)
    assert pytest.approx(raw.header.scales[0]) == 1e-4
    raw.red, raw.green, raw.blue = cloud.rgb.T.astype(np.uint16)
    raw.write(tmp_path / "eight.laz")
    np.testing.assert_array_equal(read_cloud(tmp_path / "eight.laz").rgb, cloud.rgb)


def test_small_model_units_keep_their_precision_in_laz(tmp_path: Path) -> None:
    cloud = PointCloud(xyz=np.random.default_rng(0).uniform(0, 0.02, (100, 3)))
    write_cloud(tmp_path / "c.laz", cloud)
    np.testing.assert_allclose(read_cloud(tmp_path / "c.laz").xyz, cloud.xyz, atol=1e-6)


ASCII_PLY = """ply
format ascii 1.0
comment from a scanner
obj_info nothing
element vertex 3
property double x
property double y
property double z
property uchar red
property uchar green
property uchar blue
property int TreeID
element face 1
property list uchar int vertex_indices
end_header
1 2 3 255 0 7 5
-4.5 5 6 0 1 2 6
7 8 9e2 3 4 5 7
3 0 1 2
"""


def test_ascii_ply_with_faces_and_extra_columns(tmp_path: Path) -> None:
    path = tmp_path / "a.ply"
    path.write_text(ASCII_PLY)
    cloud = read_cloud(path)
    np.testing.assert_array_equal(cloud.xyz, [[1, 2, 3], [-4.5, 5, 6], [7, 8, 900]])
    np.testing.assert_array_equal(cloud.rgb, [[255, 0, 7], [0, 1, 2], [3, 4, 5]])
    np.testing.assert_array_equal(cloud.extra["TreeID"], [5, 6, 7])


@pytest.mark.parametrize(("form", "order"), [("binary_little_endian", "<"), ("binary_big_endian", ">")])
@pytest.mark.parametrize("kind", ["f4", "f8"])
def test_binary_ply_in_both_byte_orders(tmp_path: Path, form: str, order: str, kind: str) -> None:
    name = {"f4": "float32", "f8": "double"}[kind]
    table = np.zeros(2, dtype=[("x", order + kind), ("y", order + kind), ("z", order + kind), ("q", order + "i2")])
    table["x"], table["y"], table["z"], table["q"] = [1, 2], [3.5, 4], [5, -6], [-300, 9]
    header = f"ply\nformat {form} 1.0\nelement vertex 2\nproperty {name} x\nproperty {name} y\nproperty {name} z\n"
    header += "property short q\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n"
    path = tmp_path / "b.ply"
    path.write_bytes(header.encode() + table.tobytes() + b"\x03" + b"\0" * 12)
    cloud = read_cloud(path)
    np.testing.assert_array_equal(cloud.xyz, [[1, 3.5, 5], [2, 4, -6]])
    np.testing.assert_array_equal(cloud.extra["q"], [-300, 9])
    assert cloud.rgb is None


def test_points_that_are_not_finite_are_dropped_with_a_warning(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    path = tmp_path / "a.ply"
    path.write_text(ASCII_PLY.replace("-4.5", "nan"))
    with caplog.at_level(logging.WARNING):
        cloud = read_cloud(path)
    assert len(cloud) == 2
    assert "1 of 3" in caplog.text
    np.testing.assert_array_equal(cloud.extra["TreeID"], [5, 7])
    path.write_text(ASCII_PLY.replace("1 2 3 255", "nan 2 3 255").replace("-4.5", "inf").replace("9e2", "nan"))
    with pytest.raises(CloudError, match="no points that can be used"):
        read_cloud(path)


@pytest.mark.parametrize("point_format", [3, 7])
def test_points_marked_as_withheld_or_noise_are_dropped_with_a_warning(
    tmp_path: Path, caplog: pytest.LogCaptureFixture, point_format: int
) -> None:
    laspy = pytest.importorskip("laspy")
    header = laspy.LasHeader(point_format=point_format, version="1.4")
    header.scales = np.full(3, 0.001)
    header.add_extra_dim(laspy.ExtraBytesParams(name="TreeID", type=np.int32))
    file = laspy.LasData(header)
    file.x = file.y = file.z = np.arange(6.0)
    file.classification = np.array([1, 7, 2, 18, 1, 0], np.uint8)
    file.withheld = np.array([0, 0, 0, 0, 1, 0], np.uint8)
    file.TreeID = np.arange(6, dtype=np.int32)
    file.write(tmp_path / "a.laz")
    with caplog.at_level(logging.WARNING):
        cloud = read_cloud(tmp_path / "a.laz")
    used = [0, 2, 5] if point_format >= 6 else [0, 2, 3, 5]  # where class 18 means nothing
    assert f"{6 - len(used)} points are marked as withheld or as noise" in caplog.text
    np.testing.assert_allclose(cloud.xyz[:, 0], used)
    np.testing.assert_array_equal(cloud.extra["TreeID"], used)
    chunked = open_chunks(tmp_path / "a.laz", settings=ChunkSettings(chunk_points=4, sample_slices=3, slice_points=2))
    assert chunked is not None
    told: list[int] = []
    np.testing.assert_allclose(np.concatenate(list(chunked.chunks(told.append)))[:, 0], used)
    assert told == [5 - len(used), 1]
    assert set(chunked.sample()[:, 0]) <= set(used)

    def nine(xyz: NDArray[np.float64]) -> NDArray[np.int32]:
        return np.full(len(xyz), 9, np.int32)

    copy_las(tmp_path / "a.laz", tmp_path / "b.laz", "number", nine, chunk_points=4)
    np.testing.assert_array_equal(laspy.read(tmp_path / "b.laz")["number"], np.where(np.isin(range(6), used), 9, 0))
    file.withheld = np.ones(6, np.uint8)
    file.write(tmp_path / "a.laz")
    with pytest.raises(CloudError, match="no points that can be used: 6 are marked as withheld or as noise"):
        read_cloud(tmp_path / "a.laz")


@pytest.mark.parametrize(
    ("kind", "scaled", "kept"),
    [("u1", False, False), ("i2", False, False), ("u4", False, False), ("f4", False, False), ("3u1", False, False),
     ("i4", True, False), ("i4", False, True), ("i8", False, True), ("f8", False, True)],
)  # fmt: skip
def test_numbers_have_room_whatever_another_program_wrote(tmp_path: Path, kind: str, scaled: bool, kept: bool) -> None:
    laspy = pytest.importorskip("laspy")
    header = laspy.LasHeader(point_format=6, version="1.4")
    header.scales = np.full(3, 0.001)
    steps = {"scales": np.array([0.01]), "offsets": np.array([0.0])} if scaled else {}
    for name in ("before", "TreeID", "behind"):
        numbered = {"type": kind, **steps} if name == "TreeID" else {"type": "u2"}
        header.add_extra_dim(laspy.ExtraBytesParams(name=name, **numbered))
    file = laspy.LasData(header)
    file.x = file.y = file.z = np.arange(6.0)
    file["before"], file["behind"] = np.arange(6) + 400, np.arange(6) + 900
    file.write(tmp_path / "a.laz")
    numbers = np.array([0, 1, 255, 300, 70_001, 2**31 - 1], np.int32)
    copy_las(
        tmp_path / "a.laz", tmp_path / "b.laz", "TreeID", lambda xyz: numbers[np.rint(xyz[:, 0]).astype(int)],
        chunk_points=4,
    )  # fmt: skip
    copy = laspy.read(tmp_path / "b.laz")
    np.testing.assert_array_equal(copy["TreeID"], numbers)
    assert copy["TreeID"].dtype == np.dtype(kind if kept else "i4")
    np.testing.assert_array_equal(copy["before"], file["before"])
    np.testing.assert_array_equal(copy["behind"], file["behind"])
    np.testing.assert_allclose(copy.xyz, file.xyz)


def test_text_clouds(tmp_path: Path) -> None:
    path = tmp_path / "a.xyz"
    path.write_text("# scanner\n1 2 3\n4 5 6\n")
    np.testing.assert_array_equal(read_cloud(path).xyz, [[1, 2, 3], [4, 5, 6]])
    path = tmp_path / "a.csv"
    path.write_text("X,Y,Z,Red,Green,Blue,tree\n1,2,3,9,8,7,5\n4,5,6,255,0,1,6\n")
    cloud = read_cloud(path)
    np.testing.assert_array_equal(cloud.rgb, [[9, 8, 7], [255, 0, 1]])
    np.testing.assert_array_equal(cloud.extra["tree"], [5, 6])
    path.write_text("name,of\nno,cloud\n")
    with pytest.raises(CloudError, match="not a table"):
        read_cloud(path)


@pytest.mark.parametrize("suffix", [".ply", ".las", ".laz"])
@pytest.mark.parametrize("part", [0.0, 0.001, 0.3, 0.97])
def test_cut_files_are_user_errors(tmp_path: Path, suffix: str, part: float) -> None:
    path = tmp_path / f"c{suffix}"
    write_cloud(path, make_cloud(3000))
    data = path.read_bytes()
    path.write_bytes(data[: int(len(data) * part)])
    with pytest.raises(CloudError, match="again"):
        read_cloud(path)


def test_cut_ascii_ply(tmp_path: Path) -> None:
    path = tmp_path / "a.ply"
    path.write_text(ASCII_PLY[: ASCII_PLY.index("7 8 9e2")])
    with pytest.raises(CloudError, match="2 of 3 points"):
        read_cloud(path)
    path.write_text(ASCII_PLY[: ASCII_PLY.index("e2 3 4 5")] + "\n")
    with pytest.raises(CloudError, match="cut short"):
        read_cloud(path)


def test_other_mistakes_are_user_errors(tmp_path: Path) -> None:
    with pytest.raises(CloudError, match="no file"):
        read_cloud(tmp_path / "none.ply")
    (tmp_path / "c.e57").write_bytes(b"x")
    with pytest.raises(CloudError, match=r"give a \.ply"):
        read_cloud(tmp_path / "c.e57")
    with pytest.raises(CloudError, match=r"name the file \.ply"):
        write_cloud(tmp_path / "c.obj", make_cloud(5))
    with pytest.raises(CloudError, match="no points"):
        write_cloud(tmp_path / "c.ply", PointCloud(xyz=np.empty((0, 3))))
    with pytest.raises(CloudError, match="finite"):
        write_cloud(tmp_path / "c.ply", PointCloud(xyz=np.full((2, 3), np.nan)))
    with pytest.raises(CloudError, match="confidence"):
        PointCloud(xyz=np.zeros((3, 3)), extra={"confidence": np.zeros(2)})
    path = tmp_path / "empty.ply"
    path.write_text(ASCII_PLY.replace("element vertex 3", "element vertex 0"))
    with pytest.raises(CloudError, match="no points"):
        read_cloud(path)
    path.write_text(ASCII_PLY.replace("double z", "double height"))
    with pytest.raises(CloudError, match="no x, y and z"):
        read_cloud(path)


def test_failed_write_leaves_the_old_file(tmp_path: Path) -> None:
    path = tmp_path / "c.ply"
    write_cloud(path, make_cloud(5))
    before = path.read_bytes()
    bad = make_cloud(5)
    bad.extra["name"] = np.array(["a"] * 5)
    with pytest.raises(CloudError, match="name"):
        write_cloud(path, bad)
    assert path.read_bytes() == before


def test_real_laser_scan() -> None:
    path = CLOUDS / "pine_plot.laz"
    if not path.is_file():
        pytest.skip("shared/data/clouds is missing")
    cloud = read_cloud(path)
    assert len(cloud) > 10_000
    assert np.ptp(cloud.xyz[:, :2], axis=0).max() < 30


def test_columns_named_like_dimensions_of_las_keep_their_values(tmp_path: Path) -> None:
    names = (
        "gps_time", "user_data", "scan_angle", "point_source_id", "return_number", "number_of_returns", "synthetic",
        "bit_fields", "flag_byte", "X", "ä" * 20, "long" * 9 + "a", "long" * 9 + "b",
    )  # fmt: skip
    values = np.array([-1.5, 0.0, 1e9])
    cloud = PointCloud(xyz=np.eye(3), extra={name: values + index for index, name in enumerate(names)})
    write_cloud(tmp_path / "c.laz", cloud)
    back = read_cloud(tmp_path / "c.laz")
    np.testing.assert_allclose(back.xyz, cloud.xyz, atol=1e-6)
    assert {"gps_time_", "user_data_", "scan_angle_", "X_"} <= set(back.extra)
    for index, stored in enumerate(back.extra.values()):
        np.testing.assert_array_equal(stored, values + index)
    assert len(back.extra) == len(names)


@pytest.mark.parametrize(
    ("values", "name"),
    [
        ([3.0, 0.0, 65535.0], "intensity"),
        ([3, 0, 255], "intensity"),
        ([-3.0, 0.0, 7.0], "intensity_"),
        ([0.25, 0.5, 1.0], "intensity_"),
        ([0, 1, 70_000], "intensity_"),
        ([0.0, np.nan, 1.0], "intensity_"),
    ],
)
def test_intensity_is_stored_whole_or_beside_the_dimension_of_las(
    tmp_path: Path, values: list[float], name: str
) -> None:
    write_cloud(tmp_path / "c.las", PointCloud(xyz=np.eye(3), extra={"intensity": np.array(values)}))
    back = read_cloud(tmp_path / "c.las")
    assert set(back.extra) == {name}
    np.testing.assert_array_equal(back.extra[name], values)


def test_long_integers_stay_in_las_and_are_told_in_ply(tmp_path: Path) -> None:
    times = np.array([1_700_000_000_000, -5, 2**62])
    cloud = PointCloud(xyz=np.eye(3), extra={"timestamp": times})
    write_cloud(tmp_path / "c.laz", cloud)
    np.testing.assert_array_equal(read_cloud(tmp_path / "c.laz").extra["timestamp"], times)
    with pytest.raises(CloudError, match="timestamp"):
        write_cloud(tmp_path / "c.ply", cloud)


def test_a_point_beyond_the_corners_of_a_las_file_is_left_out(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    low = np.array([452_000.0, 5_412_000.0, 400.0])
    xyz = low + np.array([[0.0, 0.0, 0.0], [30.0, 30.0, 20.0], [500.0, -40.0, 1.0]])
    stray = np.insert(xyz, 1, 0.0, axis=0)
    with las_writer(tmp_path / "c.laz", low, low + 30.0, colour=True, kinds={"TreeID": np.dtype(np.int32)}) as append:
        append(stray, np.full((4, 3), 9, np.uint8), {"TreeID": np.arange(4, dtype=np.int32)})
        append(np.zeros((1, 3)), np.zeros((1, 3), np.uint8), {"TreeID": np.zeros(1, np.int32)})
    back = read_cloud(tmp_path / "c.laz")
    np.testing.assert_allclose(back.xyz, xyz, atol=1e-4)
    assert back.extra["TreeID"].tolist() == [0, 2, 3]
    assert "2 points lie too far" in caplog.text

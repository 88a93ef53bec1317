"""Readers of point clouds."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from tests.fuzz.lies import lie_in_las, lie_in_records
from tests.fuzz.mutators import change_bytes, change_head, change_text, cut
from tests.fuzz.reader import Reader


def _columns(count: int = 60) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(0)
    return rng.uniform(0, 4, (count, 3)), rng.integers(0, 255, (count, 3)).astype(np.uint8)


def _write(*names: str):  # type: ignore[no-untyped-def]
    def make(folder: Path) -> None:
        from fsinfer.io.cloud import PointCloud, write_cloud

        xyz, rgb = _columns()
        extra = {"TreeID": np.arange(len(xyz), dtype=np.int32), "confidence": xyz[:, 0].astype(np.float32)}
        for name in names:
            write_cloud(folder / name, PointCloud(xyz=xyz, rgb=rgb, extra=extra))

    return make


def _make_las(folder: Path) -> None:
    import laspy

    _write("cloud.las")(folder)
    # With a frame in its records.
    with laspy.open(folder / "cloud.las") as reader:
        cloud = reader.read()
    wkt = 'PROJCS["a",GEOGCS["b",AUTHORITY["EPSG","4326"]],AUTHORITY["EPSG","32632"]]'
    cloud.header.vlrs.append(laspy.vlrs.known.WktCoordinateSystemVlr(wkt))
    cloud.write(folder / "frame.las")
    (folder / "cloud.las").unlink()


def _make_laz(folder: Path) -> None:
    from fsinfer.io.cloud import PointCloud, write_cloud

    rng = np.random.default_rng(0)
    for name, count in (("small.laz", 40), ("large.laz", 1900)):
        write_cloud(folder / name, PointCloud(xyz=rng.uniform(0, 4, (count, 3))))


def _make_ascii_ply(folder: Path) -> None:
    xyz, rgb = _columns(20)
    head = "ply\nformat ascii 1.0\ncomment none\nelement camera 1\nproperty float a\nelement vertex 20\n"
    head += "".join(f"property {kind} {name}\n" for kind, name in zip(["double"] * 3, "xyz", strict=True))
    head += "property uchar red\nproperty uchar green\nproperty uchar blue\nelement face 0\n"
    head += "property list uchar int vertex_indices\nend_header\n0.5\n"
    rows = "".join(" ".join(map(str, [*p, *c])) + "\n" for p, c in zip(xyz.round(3), rgb, strict=True))
    (folder / "cloud.ply").write_text(head + rows, encoding="ascii")


def _make_text(folder: Path) -> None:
    xyz, rgb = _columns(20)
    rows = [" ".join(map(str, [*p, *c])) for p, c in zip(xyz.round(3), rgb, strict=True)]
    (folder / "a.xyz").write_text("\n".join(rows) + "\n", encoding="ascii")
    (folder / "b.csv").write_text("x,y,z,r,g,b\n" + "\n".join(r.replace(" ", ",") for r in rows), encoding="ascii")
    (folder / "c.pts").write_text("20\n" + "\n".join(rows), encoding="ascii")


def _read_cloud(folder: Path) -> None:
    from fsinfer.io.chunks import open_chunks
    from fsinfer.io.cloud import read_cloud
    from fsinfer.io.las import read_epsg

    for path in sorted(folder.iterdir()):
        read_cloud(path)
        if path.suffix in (".las", ".laz"):
            read_epsg(path)
        chunked = open_chunks(path)
        if chunked is not None:
            chunked.sample()
            for _ in chunked.chunks():
                pass
            for _ in chunked.columns():
                pass


def _read_chunks(folder: Path) -> None:
    """As large clouds are read, which :func:`read_cloud` has not looked at before; and copied with tree numbers."""
    from fsinfer.io.chunks import open_chunks
    from fsinfer.io.las import read_epsg
    from fsinfer.io.las_writing import copy_las

    for path in sorted(folder.glob("*.la[sz]")):
        chunked = open_chunks(path)
        if chunked is not None:
            for _ in chunked.chunks():
                pass
            chunked.sample()
        read_epsg(path)
        target = folder.parent / f"copy{path.suffix}"
        copy_las(path, target, "TreeID", lambda xyz: np.zeros(len(xyz), np.int32), chunk_points=1_000_000)


def _make_plot_cloud(folder: Path) -> None:
    from fsinfer.io.cloud import PointCloud, write_cloud

    rng = np.random.default_rng(0)
    angle, height = rng.uniform(0, 2 * np.pi, 600), rng.uniform(0, 3, 600)
    stem = np.column_stack([0.15 * np.cos(angle), 0.15 * np.sin(angle), height])
    ground = np.column_stack([rng.uniform(-2, 2, (600, 2)), rng.normal(0, 0.01, 600)])
    write_cloud(folder / "plot.ply", PointCloud(xyz=np.concatenate([stem, ground])))


def _measure(folder: Path) -> None:
    from fsinfer.errors import CloudError
    from fsinfer.io.cloud import read_cloud
    from fsinfer.trees import measure_trees

    for path in folder.iterdir():
        points = read_cloud(path).xyz
        try:
            measure_trees(points)
        except CloudError as error:  # of points, which have no file any more
            raise CloudError(f"{path}: {error}") from error


READERS = (
    Reader(
        name="ply", what="PLY clouds, binary", make=_write("cloud.ply"), targets=("*.ply",), read=_read_cloud,
        mutators=(change_head(b"end_header"), change_bytes, cut),
    ),
    Reader(
        name="ply-text", what="PLY clouds, ASCII", make=_make_ascii_ply, targets=("*.ply",), read=_read_cloud,
        mutators=(change_head(b"end_header"), change_text, change_bytes, cut),
    ),
    Reader(
        name="las", what="LAS clouds", make=_make_las, targets=("*.las",), read=_read_cloud,
        mutators=(lie_in_las, lie_in_records, change_bytes, cut),
    ),
    Reader(
        name="laz", what="LAZ clouds", make=_make_laz, targets=("*.laz",), read=_read_cloud,
        mutators=(lie_in_las, lie_in_records, change_bytes, cut),
    ),
    Reader(
        name="las-pieces", what="LAS and LAZ clouds read and copied in pieces", make=_make_las, targets=("*.la[sz]",),
        read=_read_chunks, mutators=(lie_in_las, lie_in_records, change_bytes, cut),
    ),
    Reader(
        name="text-cloud", what="clouds as text (XYZ, CSV, PTS)", make=_make_text, targets=("*.*",), read=_read_cloud,
        mutators=(change_text, change_text, change_bytes, cut),
    ),
    Reader(
        name="measured-cloud", what="clouds with any coordinates, measured", make=_make_plot_cloud, targets=("*.ply",),
        read=_measure, mutators=(change_bytes,), most_mb=1024,
    ),
)  # fmt: skip

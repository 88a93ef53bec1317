"""What lies where in an output folder: every name once.

Workflow, check, report and the command line take names from here. The stages below know no output folder: they write
where they are told, and files of their own by their own names (a test holds those against these).
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

#: Records of the stages that were run, by which a run goes on where it was stopped.
RECORDS_FOLDER = ".fsinfer"
#: Frames that were chosen: ``images/``, the table of all frames with their scores, a sheet of those that were not.
FRAMES_FOLDER = "frames"
IMAGES_FOLDER = "images"
FRAMES_FILE = "frames.csv"
CONTACT_SHEET_FILE = "frames_contact.jpg"
#: Registered photographs in MVSNet format (``images/``, ``cams/``, ``pair.txt``) with the COLMAP model in ``sparse/``.
SCENE_FOLDER = "scene"
CAMERAS_FOLDER = "cams"
PAIRS_FILE = "pair.txt"
SPARSE_FOLDER = "sparse"
#: Depth and confidence of each view (PFM); the index beside the depth maps says at which size.
DEPTH_FOLDER = "depth"
CONFIDENCE_FOLDER = "confidence"
DEPTH_INDEX_FILE = "depth.json"
#: The fused cloud in scene units, before it is levelled and scaled.
FUSED_FOLDER = "fused"
#: The cloud in the plot's frame.
CLOUD_PLY = "cloud.ply"
CLOUD_LAZ = "cloud.laz"
FUSED_CLOUD = f"{FUSED_FOLDER}/{CLOUD_PLY}"
#: The trees: the table, the same with reasons as codes, and what is there in metres only.
TREES_CSV = "trees.csv"
TREES_JSON = "trees.json"
TREES_XLSX = "trees.xlsx"
TREES_GPKG = "trees.gpkg"
TREES_GEOJSON = "trees.geojson"
TREES_LAZ = "trees.laz"
STEM_CURVE_FILE = "stem_curve.csv"
DBH_SOURCES_FILE = "dbh_sources.csv"
#: Files that only a measurement in metres writes, so that one without a scale takes those of an earlier one away.
METRIC_TREE_FILES = (TREES_GPKG, TREES_GEOJSON, TREES_LAZ, TREES_XLSX, STEM_CURVE_FILE, DBH_SOURCES_FILE)
#: The stem map and for each tree its section and the edges of its stem in the photographs.
FIGURES_FOLDER = "figures"
STEM_MAP_FILE = "stem_map.png"
#: Names of those figures; others in their folder are the user's.
TREE_FIGURE = re.compile(r"stem_map\.png|tree_\d{3,}(_edges)?\.png")
#: Corrections of the stem map by hand, written by the user.
EDITS_FILE = "edits.csv"
#: The ends of a known length, clicked in photographs.
CLICKS_FILE = "scale_clicks.json"
#: What a run has come to: figures, warnings, versions.
PLOT_FILE = "plot.json"
REPORT_FILE = "report.html"
#: Technical traces of faults of fsinfer itself, the last one at the end.
LOG_FILE = "fsinfer.log"
#: The check of a capture: its map, the same in numbers, and small depth maps while it works.
CHECK_FOLDER = "check"
CHECK_MAP_FILE = "check.png"
CHECK_FILE = "check.json"
CHECK_WORK = f"{CHECK_FOLDER}/work"
#: Photographs and measured trees of the plot that comes with the package.
DEMO_PHOTOS_FOLDER = "photos"
DEMO_TRUTH_FILE = "truth.csv"


@dataclass(frozen=True)
class OutputFolder:
    """Paths in the output folder ``out``; nothing is created or looked up."""

    out: Path

    @property
    def records(self) -> Path:
        """Folder of the stages' records."""
        return self.out / RECORDS_FOLDER

    @property
    def frames(self) -> Path:
        """Folder of the chosen frames."""
        return self.out / FRAMES_FOLDER

    @property
    def frame_images(self) -> Path:
        """Folder of the images of the chosen frames."""
        return self.frames / IMAGES_FOLDER

    @property
    def frames_csv(self) -> Path:
        """Table of all frames with their scores."""
        return self.frames / FRAMES_FILE

    @property
    def contact_sheet(self) -> Path:
        """Sheet of the frames that were left out."""
        return self.frames / CONTACT_SHEET_FILE

    @property
    def scene(self) -> Path:
        """Scene folder in MVSNet format."""
        return self.out / SCENE_FOLDER

    @property
    def scene_images(self) -> Path:
        """Folder of the undistorted photographs."""
        return self.scene / IMAGES_FOLDER

    @property
    def sparse(self) -> Path:
        """Folder of the COLMAP model."""
        return self.scene / SPARSE_FOLDER

    @property
    def scene_parts(self) -> tuple[Path, ...]:
        """What a scene consists of: all must be there for it to be read."""
        return tuple(self.scene / name for name in (CAMERAS_FOLDER, IMAGES_FOLDER, PAIRS_FILE))

    @property
    def depth(self) -> Path:
        """Folder of the depth maps."""
        return self.out / DEPTH_FOLDER

    @property
    def depth_index(self) -> Path:
        """Index of the depth maps."""
        return self.depth / DEPTH_INDEX_FILE

    @property
    def confidence(self) -> Path:
        """Folder of the confidence maps."""
        return self.out / CONFIDENCE_FOLDER

    @property
    def fused_cloud(self) -> Path:
        """The fused cloud in scene units."""
        return self.out / FUSED_CLOUD

    @property
    def cloud_ply(self) -> Path:
        """The cloud in the plot's frame."""
        return self.out / CLOUD_PLY

    @property
    def cloud_laz(self) -> Path:
        """The same cloud, compressed."""
        return self.out / CLOUD_LAZ

    @property
    def trees_csv(self) -> Path:
        """The table of trees."""
        return self.out / TREES_CSV

    @property
    def trees_json(self) -> Path:
        """The table of trees with reasons as codes."""
        return self.out / TREES_JSON

    @property
    def trees_xlsx(self) -> Path:
        """All tables of the trees as a workbook."""
        return self.out / TREES_XLSX

    @property
    def trees_laz(self) -> Path:
        """The cloud with a ``TreeID`` for each point."""
        return self.out / TREES_LAZ

    @property
    def stem_curve(self) -> Path:
        """Diameters up the stems."""
        return self.out / STEM_CURVE_FILE

    @property
    def dbh_sources(self) -> Path:
        """What points and edges alone said of each diameter."""
        return self.out / DBH_SOURCES_FILE

    @property
    def metric_tree_files(self) -> tuple[Path, ...]:
        """Files that only a measurement in metres writes."""
        return tuple(self.out / name for name in METRIC_TREE_FILES)

    @property
    def figures(self) -> Path:
        """Folder of the trees' figures."""
        return self.out / FIGURES_FOLDER

    @property
    def stem_map(self) -> Path:
        """The stem map as a picture."""
        return self.figures / STEM_MAP_FILE

    def section_figure(self, tree_id: int) -> Path:
        """The section of a tree at breast height, with its stem curve."""
        return self.figures / f"tree_{tree_id:03d}.png"

    def edges_figure(self, tree_id: int) -> Path:
        """The edges of a tree's stem in the photographs."""
        return self.figures / f"tree_{tree_id:03d}_edges.png"

    @property
    def log(self) -> Path:
        """Technical traces of faults of fsinfer itself."""
        return self.out / LOG_FILE

    @property
    def edits(self) -> Path:
        """Corrections by hand, where the user has written some."""
        return self.out / EDITS_FILE

    @property
    def clicks(self) -> Path:
        """The clicks of ``fsinfer scale``, where there are some."""
        return self.out / CLICKS_FILE

    @property
    def plot_json(self) -> Path:
        """Figures, warnings and versions of a run."""
        return self.out / PLOT_FILE

    @property
    def report(self) -> Path:
        """The report."""
        return self.out / REPORT_FILE

    @property
    def check(self) -> Path:
        """Folder of the check."""
        return self.out / CHECK_FOLDER

    @property
    def check_map(self) -> Path:
        """The map of the check."""
        return self.check / CHECK_MAP_FILE

    @property
    def check_json(self) -> Path:
        """What the check says, in numbers."""
        return self.check / CHECK_FILE

    @property
    def check_work(self) -> Path:
        """Folder of the small depth maps while the check works."""
        return self.out / CHECK_WORK

    @property
    def demo_photos(self) -> Path:
        """Photographs of the demo plot."""
        return self.out / DEMO_PHOTOS_FOLDER

    @property
    def demo_truth(self) -> Path:
        """Measured trees of the demo plot."""
        return self.out / DEMO_TRUTH_FILE

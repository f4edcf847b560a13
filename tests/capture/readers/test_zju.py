"""ZJU-MoCap: every subject's frames, cameras and files as the dataset has them; and the imported mesh lies on
the imported masks.
"""

from __future__ import annotations

import pickle
import shutil
from pathlib import Path
from types import SimpleNamespace

import mitsuba as mi
import numpy as np
import pytest
from PIL import Image

from ndf_mi.body.skinning import skin
from ndf_mi.capture.camera import Camera
from ndf_mi.capture.capture import Capture
from ndf_mi.capture.check import problems
from ndf_mi.capture.document import Imported
from ndf_mi.capture.readers.importing import import_capture
from ndf_mi.capture.readers.source import Selection
from ndf_mi.capture.readers.zju import SUBJECTS, read_zju
from ndf_mi.commands import main
from ndf_mi.errors import InputError
from ndf_mi.experiments.protocols import ZJU
from ndf_mi.mitsuba_mesh import make_mesh

cv2 = pytest.importorskip("cv2")

#: subject: rows in annots.npy, first and last training frame, first and last frame of novel poses, cameras.
FRAMES = {"313": (1060, (1, 60), (61, 1060), 21), "315": (1400, (1, 400), (401, 1400), 21),
          "377": (617, (0, 299), (300, 499), 23), "386": (646, (0, 299), (300, 645), 23),
          "387": (654, (0, 299), (300, 653), 23), "390": (1171, (700, 999), (0, 699), 23),
          "392": (556, (0, 299), (300, 555), 23), "393": (658, (0, 299), (300, 557), 23),
          "394": (859, (0, 299), (300, 858), 23)}
THINNED = Selection(frames=150, test_frames=150, test_cameras=("Camera_B2", "Camera_B9"))
CHOSEN = {"rows": (0, 150, 300, 450), "cameras": (0, 1, 6, 8, 12, 18)}


def silhouette(camera: Camera, vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(h, w) bool: where Mitsuba, looking through the imported camera, sees the mesh."""
    scene = mi.load_dict({"type": "scene", "mesh": make_mesh("body", vertices, faces),
                          "integrator": {"type": "direct"}})
    rgba = mi.render(scene, sensor=mi.load_dict(camera.sensor(spp=16)), spp=16).numpy()
    return rgba[..., 3] > 0.5


@pytest.mark.parametrize("subject", FRAMES)
def test_frames_cameras_and_files(write_zju, subject: str) -> None:
    rows, train, pose, cameras = FRAMES[subject]
    numbered = subject in ("313", "315")
    numbers = range(1, rows + 1) if numbered else range(rows)
    written = write_zju(f"CoreView_{subject}", cameras, numbers, pattern="numbered" if numbered else "stem")
    assert set(SUBJECTS) == set(FRAMES)
    source = read_zju(written.folder)
    splits = source.splits
    assert source.name == f"zju-{subject}" and source.pose_blend_shapes
    names = [f"Camera_{i}" if numbered else f"Camera_B{i}" for i in range(1, cameras + 1)]
    assert list(source.calibrations) == names
    assert splits["train"].cameras == tuple(names[i] for i in (0, 6, 12, 18))
    assert (
        len(splits["novel_view"].cameras) == cameras - 4
        and splits["novel_view"].cameras == splits["novel_pose"].cameras
    )
    assert splits["train"].frames == tuple(range(train[0], train[1] + 1))
    assert splits["novel_view"].frames == tuple(range(train[0], train[1] + 1, 30))
    assert splits["novel_pose"].frames == tuple(range(pose[0], pose[1] + 1, 30))
    image, mask = source.images[names[6], train[0]]
    if numbered:
        stem = f"Camera (7)/CoreView_313_Camera_(7)_{train[0]:04d}_2019-08-23_16-08-50.592"
    else:
        stem = f"Camera_B7/{train[0]:06d}"
    assert image == written.folder / f"{stem}.jpg" and mask == written.folder / f"mask_cihp/{stem}.png"
    assert source.fits[train[1]] == written.folder / f"new_params/{train[1]}.npy"


def test_the_mesh_lies_on_the_masks(write_zju, smpl_file, tmp_path: Path) -> None:
    written = write_zju("CoreView_377", 23, range(500), **CHOSEN)
    source = read_zju(written.folder, selection=THINNED, size=None)
    smpl, uv = smpl_file
    lines = import_capture(source, tmp_path / "out", smpl, uv)
    assert problems(tmp_path / "out") == [] and any("0.0 mm" in line for line in lines)
    capture = Capture.read(tmp_path / "out")
    assert (capture.cameras["Camera_B1"].w, capture.cameras["Camera_B1"].h) == (48, 48)
    assert {name: split.frames for name, split in capture.splits.items()} == {
        "train": (0, 150), "novel_view": (0, 150), "novel_pose": (300, 450), "sequence": (),
    }  # fmt: skip
    for camera, frame in {("Camera_B1", 0), ("Camera_B7", 150), ("Camera_B2", 300), ("Camera_B9", 450)}:
        mask = capture.mask(camera, frame)
        row = capture.poses.index(frame)
        seen = silhouette(capture.cameras[camera], capture.poses.vertices[row], capture.body.faces)
        assert (mask & seen).sum() / (mask | seen).sum() > 0.93
        wrong = silhouette(capture.cameras[camera], capture.poses.vertices[row] * [-1, 1, 1],
                           capture.body.faces)
        assert (mask & wrong).sum() / (mask | wrong).sum() < 0.8
        image = capture.image(camera, frame)
        assert not image[~mask].any()
        np.testing.assert_allclose(np.median(image[mask], axis=0) * 255, [200, 120, 60], atol=6)


def test_world_pose_and_projection(write_zju, smpl_file, tmp_path: Path) -> None:
    """y is up; skinning gives the vertices; the cameras see them where OpenCV does, but for the lens, at half
    the size.
    """
    written = write_zju("CoreView_377", 23, range(500), **CHOSEN)
    import_capture(read_zju(written.folder, selection=THINNED, size=None), tmp_path / "out", *smpl_file)
    capture = Capture.read(tmp_path / "out")
    for frame, world in written.truth.items():
        row = capture.poses.index(frame)
        x, y, z = world.T
        np.testing.assert_allclose(capture.poses.vertices[row], np.stack([x, z, -y], 1), atol=1e-6)
        poses = capture.poses
        moved = skin(capture.body, poses.pose[row], poses.root_rotation[row], poses.translation[row],
                     poses.shape)
        np.testing.assert_allclose(np.array(moved).reshape(-1, 3), poses.vertices[row], atol=5e-6)
        for i, name in ((0, "Camera_B1"), (8, "Camera_B9")):
            matrix = written.cams["K"][i].copy()
            matrix[0, 0] = matrix[1, 1] = (matrix[0, 0] + matrix[1, 1]) / 2
            rotation, _ = cv2.Rodrigues(written.cams["R"][i])
            points, _ = cv2.projectPoints(1000 * world, rotation, written.cams["T"][i], matrix, None)
            ours = capture.cameras[name].project(poses.vertices[row])
            # OpenCV counts from the first pixel's centre, we from its corner.
            np.testing.assert_allclose(ours, (points[:, 0] + 0.5) / 2, atol=1e-4)


def test_fits_without_pose_blend_shapes_and_the_older_names(write_zju, smpl_file, tmp_path: Path) -> None:
    """313 as Neural Body reads it: params, numbers from 1 in the names; masks in `mask`; 69 entries; no
    vertices stored.
    """
    written = write_zju(
        "CoreView_313", 21, range(1, 1061), (0, 30, 60), (0, 6, 12, 18, 3),
        pattern="numbered", fits="params", masks="mask", entries=69, stored=False,
    )  # fmt: skip
    selection = Selection(frames=30, test_frames=1500, test_cameras=("Camera_4",))
    import_capture(read_zju(written.folder, selection=selection, size=None), tmp_path / "out", *smpl_file)
    assert problems(tmp_path / "out") == []
    capture = Capture.read(tmp_path / "out")
    assert (
        capture.body.pose_dirs is None
        and capture.splits["train"].frames == (1, 31)
        and capture.splits["novel_pose"].frames == (61,)
    )
    for row, frame in enumerate(capture.poses.frames):
        x, y, z = written.truth[frame].T
        np.testing.assert_allclose(capture.poses.vertices[row], np.stack([x, z, -y], 1), atol=5e-6)


def test_the_command(write_zju, smpl_file, tmp_path: Path, capsys) -> None:
    """Images of another size than 1024 are brought to it; halved it is 512."""
    written = write_zju("CoreView_377", 19, range(500), (0, 300), (0, 6), side=64, calibrated=1024)
    out = tmp_path / "out"
    smpl, uv = smpl_file
    arguments = ["capture", "import", "zju", str(written.folder), "-o", str(out), "--uv", str(uv)]
    arguments += ["--frames", "300", "--test-frames", "300"]
    arguments += ["--train-cameras", "Camera_B1", "--test-cameras", "Camera_B7"]
    assert main([*arguments, "--smpl", str(smpl)]) == 0
    assert "512 x 512" in capsys.readouterr().out
    assert main(["capture", "check", str(out)]) == 0
    assert main([*arguments, "--smpl", str(smpl)]) == 2
    assert "new or empty folder" in capsys.readouterr().err
    shutil.rmtree(out)
    assert main([*arguments, "--scale", "0.25"]) == 0  # the mesh alone
    capture = Capture.read(out)
    assert not capture.body.skinned and capture.cameras["Camera_B1"].w == 256


def test_differences_from_the_protocol_are_known_after_importing(
    write_zju, smpl_file, tmp_path: Path
) -> None:
    """Every fifth frame, at another size and without a camera: enough for the protocol's least numbers, and
    reported in its notes.
    """
    rows = sorted({*range(0, 300, 5), *range(300, 500, 30)})
    written = write_zju("CoreView_377", 22, range(500), rows,
                        lambda row: range(22) if row % 30 == 0 else (0, 6, 12, 18), side=24)
    names = [f"Camera_B{i + 1}" for i in range(22)]
    test = tuple(name for i, name in enumerate(names) if i not in (0, 6, 12, 18, 21))
    source = read_zju(written.folder, selection=Selection(frames=5, test_cameras=test), size=None)
    import_capture(source, tmp_path / "out", *smpl_file, scale=1.0)
    capture = Capture.read(tmp_path / "out")
    assert capture.imported == Imported("zju", "377", tuple(names), 5, 30, 1.0)
    ZJU.check(capture)
    few, view, pose, size = ZJU.notes({"edge_kernel": 3}, capture)
    assert all(fact in few for fact in ("60", "300", "377")) and "1024²" in size
    assert "novel view" in view and "Camera_B22" in view and "novel pose" in pose


class TestBadInput:
    @pytest.fixture
    def written(self, small_subject, tmp_path: Path):
        folder = shutil.copytree(small_subject.folder, tmp_path / "CoreView_377")
        return SimpleNamespace(**{**vars(small_subject), "folder": folder})

    def attempt(self, folder: Path, smpl_file, out: Path, **changes) -> InputError:
        selection = Selection(300, 300, ("Camera_B1",), ("Camera_B7",))
        smpl, uv = changes.get("smpl", smpl_file[0]), changes.get("uv", smpl_file[1])
        with pytest.raises(InputError) as raised:
            source = read_zju(folder, changes.get("subject"), selection, changes.get("fits"), size=None)
            import_capture(source, out, smpl, uv, changes.get("scale", 0.5))
        assert not out.exists() and not [p for p in out.parent.iterdir() if p.name.startswith(f".{out.name}")]
        return raised.value

    @pytest.mark.parametrize(("name", "words"), [
        ("annots.npy", "no such file"),
        ("new_params/300.npy", "no such file"),
        ("new_vertices/0.npy", "no such file"),
        ("Camera_B7/000300.jpg", "no such file"),
        ("mask_cihp/Camera_B1/000000.png", "no such file"),
    ])  # fmt: skip
    def test_missing(self, written, smpl_file, tmp_path: Path, name: str, words: str) -> None:
        (written.folder / name).unlink()
        error = self.attempt(written.folder, smpl_file, tmp_path / "out")
        assert error.where == str(written.folder / name) and words in error.found

    @pytest.mark.parametrize("name", [
        "annots.npy", "new_params/300.npy", "new_vertices/0.npy", "Camera_B7/000300.jpg",
        "mask_cihp/Camera_B7/000300.png",
    ])  # fmt: skip
    def test_truncated(self, written, smpl_file, tmp_path: Path, name: str) -> None:
        file = written.folder / name
        file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])
        assert self.attempt(written.folder, smpl_file, tmp_path / "out").where.startswith(str(file))

    def test_parents_that_were_made_for_it_are_removed(self, written, smpl_file, tmp_path: Path) -> None:
        file = written.folder / "Camera_B7/000300.jpg"
        file.write_bytes(b"no image")
        (tmp_path / "there").mkdir()
        source = read_zju(written.folder, None, Selection(300, 300, ("Camera_B1",), ("Camera_B7",)),
                          size=None)
        with pytest.raises(InputError, match=r"000300.jpg"):
            import_capture(source, tmp_path / "there/not/yet/out", *smpl_file)
        assert not list((tmp_path / "there").iterdir())

    @pytest.mark.parametrize(("key", "value", "words"), [
        ("poses", np.full((1, 72), 0.1), "for the root"),
        ("poses", np.zeros((1, 156)), "156 numbers"),
        ("Rh", np.full((1, 3), np.nan), "not finite"),
        ("Th", np.zeros(4), "(4,)"),
        ("Th", np.array([[300.0, -200, 1000]]), "at most 20 mm"),
        ("shapes", None, "only poses, Rh, Th"),
        ("poses", [[0.0] * 72, [0.0]], "poses: found rows of unequal length"),
    ])  # fmt: skip
    def test_fits(self, written, smpl_file, tmp_path: Path, key: str, value, words: str) -> None:
        file = written.folder / "new_params/0.npy"
        fit = np.load(file, allow_pickle=True).item()
        fit = {k: v for k, v in {**fit, key: value}.items() if v is not None}
        np.save(file, fit, allow_pickle=True)
        assert words in str(self.attempt(written.folder, smpl_file, tmp_path / "out"))

    @pytest.mark.parametrize(("change", "words"), [
        (lambda a: a["cams"].pop("D"), "cams"),
        (lambda a: a["cams"].update(K=np.float64(1)), "cams"),
        (lambda a: a["cams"]["K"].__setitem__(0, [[1, 0, 0], [0, 1]]), "rows of unequal length"),
        (lambda a: a["cams"].update(T=[t / 1000 for t in a["cams"]["T"]]), "in metres"),
        (lambda a: a["cams"]["R"].__setitem__(0, np.eye(3) * 2), "a rotation from world to camera"),
        (lambda a: a["cams"]["K"].__setitem__(0, np.zeros((3, 3))), "focal lengths"),
        (lambda a: a["cams"]["D"].__setitem__(0, np.ones(8)), "8 coefficients"),
        (lambda a: a["ims"].__delitem__(slice(400, None)), "400 frames; expected at least 500"),
        (lambda a: a["ims"][3]["ims"].pop(), "18 images"),
        (lambda a: a["ims"][3]["ims"].__setitem__(0, "Camera_B1/first.jpg"), "the name first.jpg"),
        (lambda a: a["ims"][3]["ims"].__setitem__(0, "../000003.jpg"), "a path inside"),
        (lambda a: a["ims"][3]["ims"].__setitem__(0, "Camera_B1/000004.jpg"), "images of the frames [3, 4]"),
        (lambda a: a["ims"].__setitem__(4, a["ims"][3]), "frame 3 twice"),
        (lambda a: a.pop("ims"), "no cams or no ims"),
    ])  # fmt: skip
    def test_annotations(self, written, smpl_file, tmp_path: Path, change, words: str) -> None:
        file = written.folder / "annots.npy"
        held = np.load(file, allow_pickle=True).item()
        change(held)
        np.save(file, held, allow_pickle=True)
        error = self.attempt(written.folder, smpl_file, tmp_path / "out")
        assert words in str(error) and "annots.npy" in error.where

    def test_others(self, written, smpl_file, tmp_path: Path) -> None:
        out = tmp_path / "out"
        assert "one of 313" in self.attempt(written.folder, smpl_file, out, subject="378").expected
        assert "--scale" in self.attempt(written.folder, smpl_file, out, scale=0.0).where
        assert "params" in self.attempt(written.folder, smpl_file, out, fits="params").where
        assert "--smpl" in self.attempt(written.folder, smpl_file, out, smpl=None, uv=None).where
        written.folder.rename(tmp_path / "somebody")
        assert "--subject" in self.attempt(tmp_path / "somebody", smpl_file, out).repair
        (tmp_path / "somebody").rename(written.folder)

        # A mask of somebody else, and an empty one: both after other images have been written.
        mask = written.folder / "mask_cihp/Camera_B7/000300.png"
        Image.fromarray(np.zeros((32, 32), np.uint8)).save(mask)
        assert "an empty mask" in self.attempt(written.folder, smpl_file, out).found
        corner = np.zeros((32, 32), np.uint8)
        corner[:4, :4] = 1
        Image.fromarray(corner).save(mask)
        assert "of the fitted body's vertices" in self.attempt(written.folder, smpl_file, out).found

    def test_a_model_of_another_size(self, written, smpl_file, tmp_path: Path) -> None:
        held = pickle.loads(smpl_file[0].read_bytes())
        few = {**held, "kintree_table": held["kintree_table"][:, :20], "weights": np.full((162, 20), 0.05)}
        few |= {"J_regressor": held["J_regressor"][:20], "posedirs": held["posedirs"][..., :171]}
        (tmp_path / "few.pkl").write_bytes(pickle.dumps(few))
        assert "a model of 20 joints" in self.attempt(written.folder, smpl_file, tmp_path / "out",
                                                      smpl=tmp_path / "few.pkl").found
        for file in (written.folder / "new_vertices").iterdir():
            np.save(file, np.zeros((6890, 3), np.float32))
        refused = self.attempt(written.folder, smpl_file, tmp_path / "out")
        assert "a model of 162 vertices; expected 6890" in str(refused)

    @pytest.mark.parametrize(("options", "words"), [
        ({"frames": 0}, "--frames"),
        ({"frames": 7}, "a multiple of --frames"),
        ({"train_cameras": ("Camera_X",)}, "found Camera_X; expected .*Camera_B1"),
        ({"train_cameras": ("Camera_B1",), "test_cameras": ("Camera_B1",)}, "a training camera"),
    ])  # fmt: skip
    def test_selection(self, written, options: dict, words: str) -> None:
        with pytest.raises(InputError, match=words):
            read_zju(written.folder, selection=Selection(**options))

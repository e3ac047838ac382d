"""What a COLMAP project holds: the fullest model is used, the rest is named, names find their files
where there is one alone."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from radiant_core.errors import BadInput
from radiant_core.io.colmap.candidates import find_models, notes_on_project, picture_folder
from radiant_core.io.colmap.image_files import match_images, photographs_without_pose, read_with_files, unposed_count
from radiant_core.io.colmap.text import write_model
from radiant_core.sfm.colmap.calls import pycolmap
from tests.colmap_projects import hamlet_model, pointless, renamed, write_photographs

ALL = [f"drone_{number:04d}.jpg" for number in range(12)]


def write_part(folder: Path, num_images: int, form: str = "text", *, points: bool = True) -> None:
    """The first images of the hamlet as a model."""
    model = hamlet_model() if points else pointless(hamlet_model())
    write_model(folder, model.without(ALL[num_images:]))
    if form == "binary":
        pycolmap.Reconstruction(folder).write_binary(folder)
        for path in folder.glob("*.txt"):
            path.unlink()


@pytest.mark.parametrize("form", ["text", "binary"])
@pytest.mark.parametrize(
    ("parts", "expected"),
    [
        ({"sparse/0": 3, "sparse/1": 12}, "sparse/1"),
        ({"sparse/0": 12, "sparse/1": 3}, "sparse/0"),
        ({"sparse/0": 5, "sparse/2": 5, "sparse/10": 9}, "sparse/10"),
        ({"sparse": 12, "sparse/0": 3}, "sparse"),
        ({"sparse": 3, "sparse/0": 12}, "sparse/0"),
        ({"sparse/geo": 12, "sparse/0": 11}, "sparse/geo"),
        ({"sparse/0": 12, "sparse/1": 12}, "sparse/0"),
        ({"sparse/2": 7, "sparse/10": 7}, "sparse/2"),
        ({"sparse/model/0": 12, "sparse/0": 4}, "sparse/model/0"),
    ],
)
def test_the_model_with_the_most_images_is_used_and_the_others_are_named(
    parts: dict[str, int], expected: str, form: str, tmp_path: Path
) -> None:
    (tmp_path / "images").mkdir()
    for place, count in parts.items():
        write_part(tmp_path / place, count, form)
    models = find_models(tmp_path)
    assert models[0].folder == tmp_path / expected and models[0].num_images == parts[expected]
    (note,) = notes_on_project(tmp_path)
    assert note.startswith(f"the model {expected} is used ({parts[expected]} images, 576 points), ")
    assert all(f"{place} ({count} images" in note for place, count in parts.items() if place != expected)


def test_of_equal_numbers_of_images_the_points_decide(tmp_path: Path) -> None:
    (tmp_path / "images").mkdir()
    write_part(tmp_path / "sparse" / "0", 12, points=False)
    write_part(tmp_path / "sparse" / "1", 12)
    assert find_models(tmp_path)[0].folder.name == "1"


def test_a_model_that_is_cut_or_whose_file_lacks_is_not_chosen_before_a_whole_one(tmp_path: Path) -> None:
    (tmp_path / "images").mkdir()
    write_part(tmp_path / "sparse" / "0", 12, "binary")
    write_part(tmp_path / "sparse" / "1", 12)
    write_part(tmp_path / "sparse" / "2", 3)
    (tmp_path / "sparse" / "0" / "images.bin").write_bytes((tmp_path / "sparse" / "0" / "images.bin").read_bytes()[:100])
    (tmp_path / "sparse" / "1" / "points3D.txt").unlink()
    assert find_models(tmp_path)[0].folder.name == "2"
    (note,) = notes_on_project(tmp_path)
    assert "sparse/0 (no images that can be read), sparse/1 (no images that can be read)" in note


@pytest.mark.parametrize(
    "place", ["distorted/sparse/0", "dense/sparse", "dense/0/sparse", "undistorted/sparse", "colmap/sparse/0", "sparse_ned", "."]
)
def test_a_model_that_lies_elsewhere_is_named(place: str, tmp_path: Path) -> None:
    write_photographs(tmp_path / "images", ALL[:2])
    write_part(tmp_path / place, 5)
    shown = Path(place).as_posix()
    assert notes_on_project(tmp_path) == (
        f"not used: the COLMAP model in {shown} (5 images, 576 points): put its photographs into images/ and it into sparse/ to use its "
        "poses.",
    )
    write_part(tmp_path / "sparse" / "0", 4)
    assert f"not used: {shown} (5 images, 576 points)." in notes_on_project(tmp_path)[0]


def test_a_model_beside_loose_photographs_is_named(tmp_path: Path) -> None:
    write_photographs(tmp_path, ALL[:2])
    write_part(tmp_path / "sparse" / "0", 4)
    assert "not used: the COLMAP model in sparse/0" in notes_on_project(tmp_path)[0]
    assert notes_on_project(tmp_path, for_poses=True) == ()


def test_models_of_a_run_in_the_project_are_no_candidates(tmp_path: Path) -> None:
    (tmp_path / "images").mkdir()
    write_part(tmp_path / "sparse" / "0", 4)
    write_part(tmp_path / "dense" / "sfm" / "sparse", 9)
    (tmp_path / "dense" / "sfm" / "result.json").write_text("{}")
    assert notes_on_project(tmp_path) == ()


def test_a_model_in_both_formats_is_said_to_be(tmp_path: Path) -> None:
    (tmp_path / "images").mkdir()
    write_part(tmp_path / "sparse" / "0", 4, "binary")
    write_part(tmp_path / "text", 12)
    for path in (tmp_path / "text").iterdir():
        shutil.copy(path, tmp_path / "sparse" / "0")
    (note,) = notes_on_project(tmp_path)
    assert note == "sparse/0 holds a model twice (4 images in .bin, 12 images in .txt): the .bin files are used, the others are not."


def test_smaller_copies_of_the_photographs_are_named_and_used_where_there_are_no_others(tmp_path: Path) -> None:
    write_part(tmp_path / "sparse" / "0", 4)
    for name, count in (("images_8", 2), ("images_4", 3), ("input", 2)):
        write_photographs(tmp_path / name, ALL[:count])
    assert picture_folder(tmp_path) == tmp_path / "images_4"
    taken, unused = notes_on_project(tmp_path)
    assert taken == f"there is no folder images in {tmp_path.name}: the photographs are taken from images_4."
    assert unused == "the photographs are those in images_4; not used: images_8 (2 photographs), input (2 photographs)."
    write_photographs(tmp_path / "images", ALL[:4])
    assert picture_folder(tmp_path) == tmp_path / "images"
    (unused,) = notes_on_project(tmp_path)
    assert "not used: images_4 (3 photographs), images_8 (2 photographs), input (2 photographs)." in unused


def test_photographs_without_a_pose_are_counted(tmp_path: Path) -> None:
    write_photographs(tmp_path / "images")
    write_photographs(tmp_path / "images", ALL[:1], lambda name: f"more/{name}")
    write_part(tmp_path / "model", 9)
    _, files = read_with_files(tmp_path / "model", tmp_path / "images")
    unposed = photographs_without_pose(files)
    assert unposed == (*ALL[9:], "more/drone_0000.jpg")
    assert unposed_count(unposed, files) == ("4 of 13 photographs in images have no pose in the model and are left out.",)


def test_what_is_no_photograph_has_no_pose_to_lack(tmp_path: Path) -> None:
    write_photographs(tmp_path / "images", ALL[:9])
    write_photographs(tmp_path / "card", ALL[9:])
    (tmp_path / "images" / "card").symlink_to(tmp_path / "card")
    for made in ("._drone_0000.jpg", ".thumbs/drone_0000.jpg", "masks/drone_0000.jpg.png"):
        (tmp_path / "images" / made).parent.mkdir(exist_ok=True)
        (tmp_path / "images" / made).touch()
    write_part(tmp_path / "model", 12)
    _, files = read_with_files(tmp_path / "model", tmp_path / "images")
    assert files.renamed == {name: f"card/{name}" for name in ALL[9:]}
    assert photographs_without_pose(files) == ()


NAMES: list[tuple[str, list[str], list[str], dict[str, str]]] = [
    ("as they are", ["a.jpg", "b.jpg"], ["a.jpg", "b.jpg"], {"a.jpg": "a.jpg", "b.jpg": "b.jpg"}),
    ("a folder more", ["images/a.jpg"], ["a.jpg"], {"images/a.jpg": "a.jpg"}),
    ("a folder less", ["a.jpg"], ["cam0/a.jpg"], {"a.jpg": "cam0/a.jpg"}),
    ("a whole path", ["/home/me/flight/a.jpg"], ["a.jpg"], {"/home/me/flight/a.jpg": "a.jpg"}),
    ("of Windows", ["C:\\flight\\cam0\\a.jpg"], ["cam0/a.jpg", "cam1/a.jpg"], {"C:\\flight\\cam0\\a.jpg": "cam0/a.jpg"}),
    ("up and down", ["../images/a.jpg"], ["a.jpg"], {"../images/a.jpg": "a.jpg"}),
    ("letter case", ["A.JPG"], ["a.jpg"], {"A.JPG": "a.jpg"}),
    ("case of a folder", ["Cam0/a.jpg"], ["cam0/a.jpg"], {"Cam0/a.jpg": "cam0/a.jpg"}),
    ("ending", ["a.jpg"], ["a.png"], {"a.jpg": "a.png"}),
    ("ending and case", ["images/A.tiff"], ["a.JPG"], {"images/A.tiff": "a.JPG"}),
    ("no ending", ["frame.0001"], ["frame.0001.jpg"], {"frame.0001": "frame.0001.jpg"}),
    ("an ending that is none", ["frame.0001", "frame.0002"], ["frame.jpg"], {}),
    ("umlauts", ["Bäume/ÄHRE 1.jpg"], ["ähre 1.jpg"], {"Bäume/ÄHRE 1.jpg": "ähre 1.jpg"}),
    ("marked letters", ["B\u00e4ume/\u00e4.jpg"], ["Ba\u0308ume/a\u0308.jpg"], {"B\u00e4ume/\u00e4.jpg": "Ba\u0308ume/a\u0308.jpg"}),
    ("here", ["./a.jpg", "cam0//b.jpg"], ["a.jpg", "cam0/b.jpg"], {"./a.jpg": "a.jpg", "cam0//b.jpg": "cam0/b.jpg"}),
    ("two files", ["a.jpg"], ["a.png", "a.tif"], {}),
    ("two folders", ["a.jpg"], ["cam0/a.jpg", "cam1/a.jpg"], {}),
    ("two names", ["cam0/a.jpg", "cam1/a.jpg"], ["a.jpg"], {}),
    ("another camera", ["cam0/a.jpg"], ["cam1/a.jpg"], {}),
    ("one is taken", ["a.jpg", "A.jpg"], ["a.jpg"], {"a.jpg": "a.jpg"}),
    ("the nearer one", ["a.tif"], ["a.jpg", "sub/a.jpg"], {"a.tif": "a.jpg"}),
    ("a mask", ["a.jpg"], ["a.jpg.png"], {}),
    ("another name", ["a.jpg"], ["q.jpg"], {}),
]


@pytest.mark.parametrize(("case", "names", "paths", "expected"), NAMES, ids=[case for case, *_ in NAMES])
def test_a_name_is_taken_for_the_one_file_that_it_can_mean(
    case: str, names: list[str], paths: list[str], expected: dict[str, str], tmp_path: Path
) -> None:
    for path in paths:
        (tmp_path / path).parent.mkdir(exist_ok=True)
        (tmp_path / path).touch()
    assert match_images(names, tmp_path).files == expected


def test_what_was_taken_for_another_name_is_said_and_what_is_not_there_with_both_sides(tmp_path: Path) -> None:
    write_photographs(tmp_path / "images")
    write_model(tmp_path / "model", renamed(hamlet_model(), lambda name: f"images/{name}"))
    model, files = read_with_files(tmp_path / "model", tmp_path / "images")
    assert [image.name for image in model.images] == ALL
    assert files.notes() == (
        "12 of 12 images have another name in the model than their file in images, such as 'images/drone_0000.jpg' for 'drone_0000.jpg'.",
    )
    assert "drone" not in files.count()[0]
    write_model(tmp_path / "model", renamed(hamlet_model(), lambda name: name.replace("drone", "DJI")))
    with pytest.raises(BadInput) as refused:
        read_with_files(tmp_path / "model", tmp_path / "images")
    assert str(refused.value) == (
        f"image 'DJI_0000.jpg' of the model is not in {tmp_path / 'images'} (12 of 12 in all), which holds 12 photographs, such as "
        "'drone_0000.jpg': give the folder of the model's images, or make the names alike."
    )


def test_a_name_that_leaves_the_folder_reads_nothing_outside(tmp_path: Path) -> None:
    """A path out of the folder is taken for a file in it, or refused: never followed."""
    write_photographs(tmp_path, ALL[:1])
    write_photographs(tmp_path / "images", ALL[1:])
    write_model(tmp_path / "model", hamlet_model())
    text = (tmp_path / "model" / "images.txt").read_text()
    (tmp_path / "model" / "images.txt").write_text(text.replace("drone_0000.jpg", "../drone_0000.jpg"))
    with pytest.raises(BadInput, match=r"image '\.\./drone_0000\.jpg' of the model is not in"):
        read_with_files(tmp_path / "model", tmp_path / "images")

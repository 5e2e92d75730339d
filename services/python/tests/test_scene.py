"""Scenes from arrays of any kind."""

import copy
import pickle

import numpy as np
import pytest

import repose


def test_a_depth_image_with_labels_gives_objects_where_they_are(scene, view):
    assert [o.id for o in scene.objects] == [1, 2, 3]
    assert scene.objects[1].centroid_m == pytest.approx([0.51, 0.07, 0.08], abs=0.05)
    points = scene.points_of(2)
    assert points.dtype == np.float32
    assert points.shape == (scene.objects[1].points, 3)
    assert points.min(axis=0) == pytest.approx([0.45, 0.0, 0.0], abs=0.02)
    assert scene.surfaces[0].height_m == pytest.approx(0.0, abs=0.005)
    np.testing.assert_allclose(scene.world_from_camera, view.world_from_camera)
    assert scene.colors is not None
    assert scene.colors.shape == scene.points.shape


def test_without_labels_the_objects_are_found(view):
    found = view.scene(labels=None)
    assert len(found.objects) == 3


def test_metres_and_counts_of_the_same_depth_give_the_same_objects(scene, view):
    metres = view.scene(depth=(view.depth / 1000.0).astype(np.float32))
    for a, b in zip(scene.objects, metres.objects, strict=True):
        np.testing.assert_allclose(a.centroid_m, b.centroid_m, atol=1e-4)
    in_half_units = view.scene(depth=view.depth * 2, depth_unit_m=0.0005)
    np.testing.assert_allclose(in_half_units.points, scene.points, atol=1e-6)


def test_what_is_no_reading_is_none(view):
    depth = (view.depth / 1000.0).astype(np.float64)
    depth[0, :4] = [np.nan, np.inf, -1.0, 0.0]
    assert view.scene(depth=depth).meta["unseen"]["pixels_without_reading"] >= 4


def test_a_scene_travels_as_bytes_with_its_id(scene):
    copy = repose.Scene.from_bytes(scene.to_bytes())
    assert copy.id == scene.id
    assert len(scene.id) == 64
    np.testing.assert_array_equal(copy.points, scene.points)


def test_a_scene_cannot_be_changed(scene):
    with pytest.raises(ValueError, match="read-only"):
        scene.points[0, 0] = 1.0
    scene.meta["objects"].clear()
    scene.meta["camera"]["world_from_camera"][3] += 1.0
    assert [o["id"] for o in scene.meta["objects"]] == [o.id for o in scene.objects] == [1, 2, 3]
    np.testing.assert_allclose(scene.world_from_camera.ravel(), scene.meta["camera"]["world_from_camera"])


def test_a_scene_is_the_same_in_another_process_and_in_a_copy(scene):
    for other in (pickle.loads(pickle.dumps(scene)), copy.deepcopy(scene)):
        assert (type(other), other.id, other.meta) == (repose.Scene, scene.id, scene.meta)
        np.testing.assert_array_equal(other.points, scene.points)


class ByProtocol:
    """An array of another library: it shows its memory through one protocol only."""

    def __init__(self, array, protocol):
        self._array, self._protocol = array, protocol

    def __getattr__(self, name):
        if name == self._protocol or (self._protocol == "__dlpack__" and name == "__dlpack_device__"):
            return getattr(self._array, name)
        raise AttributeError(name)


class ByDlpack:
    """A tensor that speaks DLPack and nothing else, as on another device where `device` is not 1."""

    def __init__(self, array, device=1):
        self._array, self._device = array, device

    def __dlpack__(self, **options):
        if self._device != 1:
            raise BufferError("the memory is on another device")
        return self._array.__dlpack__(**options)

    def __dlpack_device__(self):
        return (self._device, 0)


@pytest.mark.parametrize(
    "wrapped",
    [
        lambda a: ByProtocol(a, "__array_interface__"),
        lambda a: ByProtocol(a, "__array__"),
        ByDlpack,
        memoryview,
        np.asfortranarray,
        lambda a: a.astype(a.dtype.newbyteorder(">")),
        np.ma.asarray,
    ],
    ids=["array_interface", "array", "dlpack", "buffer", "fortran", "big_endian", "unmasked"],
)
def test_arrays_of_other_libraries_are_taken(view, scene, wrapped):
    taken = view.scene(depth=wrapped(view.depth.copy()), color=wrapped(view.color.copy()), labels=wrapped(view.labels.copy()))
    assert taken.id == scene.id


@pytest.mark.parametrize("name", ["depth", "labels", "world_from_camera"])
def test_values_that_a_mask_hides_are_not_taken_for_readings(view, name):
    masked = np.ma.masked_array(getattr(view, name), mask=True)
    with pytest.raises(repose.InvalidArgument) as refused:
        view.scene(**{name: masked})
    assert refused.value.field == name


def test_a_camera_matrix_may_be_of_the_class_matrix(view, scene):
    assert view.scene(K=np.matrix(view.camera_matrix)).id == scene.id


def test_a_tensor_on_another_device_is_refused_by_name(view):
    with pytest.raises(repose.InvalidArgument) as raised:
        view.scene(depth=ByDlpack(view.depth.copy(), device=2))
    assert raised.value.field == "depth"


class OfGradients:
    """A tensor that is a part of a computation: PyTorch gives no array of it."""

    def __array__(self, dtype=None, copy=None):
        raise RuntimeError("Can't call numpy() on Tensor that requires grad. Use tensor.detach().numpy() instead.")


def test_a_tensor_that_gradients_are_asked_of_is_refused_by_name_with_what_to_do(view):
    with pytest.raises(repose.InvalidArgument, match=r"detach\(\)") as raised:
        view.scene(depth=OfGradients())
    assert raised.value.field == "depth"


@pytest.mark.parametrize(
    ("change", "field"),
    [
        ({"depth": np.zeros((4, 4, 1))}, "depth"),
        ({"depth": np.zeros((4, 4), np.int32)}, "depth"),
        ({"depth": np.zeros((0, 0), np.uint16), "color": None, "labels": None}, "width"),
        ({"K": np.eye(4)}, "K"),
        ({"K": "front"}, "K"),
        ({"K": [-1.0, 500.0, 1.0, 1.0]}, "fx"),
        ({"K": [np.nan, 500.0, 1.0, 1.0]}, "fx"),
        ({"color": np.zeros((3, 3, 3), np.uint8)}, "color"),
        ({"labels": np.full((240, 320), -1)}, "labels"),
        ({"world_from_camera": np.ones((4, 4))}, "world_from_camera"),
        ({"world_from_camera": np.eye(3)}, "world_from_camera"),
        ({"world_from_camera": np.stack([np.eye(4), np.eye(4)])}, "world_from_camera"),
        ({"camera": "No Chunk"}, "camera"),
        ({"depth_unit_m": 0.0}, "depth_unit_m"),
        ({"depth": np.ones((240, 320)), "depth_unit_m": float("nan")}, "depth_unit_m"),
    ],
)
def test_what_cannot_be_used_is_refused_by_name(view, change, field):
    with pytest.raises(repose.InvalidArgument) as raised:
        view.scene(**change)
    assert raised.value.code == "invalid_argument"
    assert raised.value.field == field
    assert isinstance(raised.value, ValueError)


def test_an_object_that_is_not_there_is_not_found(scene):
    with pytest.raises(repose.NotFound) as raised:
        scene.points_of(9)
    assert raised.value.field == "object_id"

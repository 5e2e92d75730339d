"""Planning in this process: the same answers as the command."""

import json
import pickle
import threading
import time

import numpy as np
import pytest
from conftest import readme_blocks

import repose

READY_RAD = [0.0, -0.785, 0.0, -2.356, 0.0, 1.571, 0.785]


@pytest.fixture(scope="module")
def planned(scene):
    return repose.plan(scene, move=1, goal=[("left_of", 2), ("not", "near", 3)], count=3, seed=5)


def test_a_placement_comes_with_its_evidence(planned, scene):
    assert planned.outcome == "found"
    assert planned.goal == ["left_of:2", "not:near:3"]
    best = planned[0]
    assert best.placed_from_observed.shape == (4, 4)
    assert best.relations.shape == best.holds.shape == best.margins_m.shape == (2,)
    assert best.holds.all()
    assert planned.transforms.shape == (len(planned), 4, 4)
    placed = best.apply(scene.points_of(1))
    assert placed.shape == scene.points_of(1).shape
    # Seen from behind the robot, left of object 2 is at greater y.
    assert placed[:, 1].min() > scene.points_of(2)[:, 1].mean()


def test_the_result_is_the_commands_byte_for_byte(planned, frame_folder, command):
    code, printed = command(
        "plan", str(frame_folder), "--move", "1", "--goal", "left_of:2", "--goal", "not:near:3", "--count", "3", "--seed", "5", "--json"
    )
    assert code == 0
    assert printed == planned.json + "\n"


def test_relations_and_scores_are_the_commands(scene, planned, frame_folder, command, tmp_path):
    _, printed = command("relations", str(frame_folder), "--json")
    expected = json.loads(printed)["pairs"]
    pairs = repose.relations(scene)
    assert [(p.query, p.anchor) for p in pairs] == [(p["query"], p["anchor"]) for p in expected]
    for pair, want in zip(pairs, expected, strict=True):
        assert pair.learned.tolist() == want["learned"]
        assert pair.rule.tolist() == want["rule"]
    transforms = tmp_path / "transforms.json"
    transforms.write_text(json.dumps([m.ravel().tolist() for m in planned.transforms]))
    _, printed = command("score", str(frame_folder), "--move", "1", "--anchor", "2", "--transforms", str(transforms), "--json")
    expected = json.loads(printed)
    scores = repose.score(scene, 1, planned.transforms, anchors=[2])
    assert scores.relations.shape == (len(planned), 1, 10)
    np.testing.assert_array_equal(scores.realism, np.array(expected["realism"], np.float32))
    np.testing.assert_array_equal(scores.relations[:, 0], np.array(expected["relations"], np.float32))


def test_a_frame_folder_and_arrays_give_the_same_scene(scene, frame_folder):
    assert repose.Scene.from_folder(frame_folder).id == scene.id


def test_where_nothing_fits_the_answer_says_what_was_rejected(scene):
    far = {"min_m": [5.0, 5.0, 0.0], "max_m": [5.1, 5.1, 0.1], "inside": True}
    none = repose.plan(scene, move=1, goal=["left_of:2"], region=[far], variant="geometric")
    assert (none.outcome, len(none), none.transforms.shape) == ("none", 0, (0, 4, 4))
    assert sum(none.rejections.values()) > 0


@pytest.mark.parametrize(
    ("kind", "field", "options"),
    [
        (repose.InvalidArgument, "goal[0]", {"goal": [("beside", 2)]}),
        (repose.InvalidArgument, "goal[0].anchor", {"goal": [("left_of", 1)]}),
        (repose.InvalidArgument, "goal", {"goal": [("not", "near", 2)]}),
        (repose.InvalidArgument, "goal", {"goal": "left_of:2"}),
        (repose.InvalidArgument, "count", {"count": 0}),
        (repose.InvalidArgument, "min_clearance_m", {"min_clearance_m": float("nan")}),
        (repose.InvalidArgument, "variant", {"variant": "worst"}),
        (repose.InvalidArgument, "speed", {"speed": 3}),
        (repose.InvalidArgument, "budget.iterations", {"budget": {"iterations": 0}}),
        (repose.InvalidArgument, "move", {"move": None}),
        (repose.InvalidArgument, "move", {"move": "mug"}),
        # Neither is rounded to the object beside it.
        (repose.InvalidArgument, "move", {"move": 1.7}),
        (repose.InvalidArgument, "goal[0].anchor", {"goal": [("left_of", 2.7)]}),
        (repose.NotFound, "query", {"move": 9}),
    ],
)
def test_errors_name_the_field(scene, kind, field, options):
    with pytest.raises(kind) as raised:
        repose.plan(scene, **{"move": 1, "goal": [("left_of", 2)], **options})
    assert raised.value.field == field
    assert raised.value.code == kind.code


def test_arrays_and_numbers_of_numpy_are_taken_wherever_they_stand(scene):
    region = {"min_m": np.array([0.0, -1.0, 0.0]), "max_m": np.array([1, 1, 1], np.float32), "inside": np.bool_(True)}
    plain = {"min_m": [0.0, -1.0, 0.0], "max_m": [1.0, 1.0, 1.0], "inside": True}
    taken = repose.plan(
        scene, np.int64(1), [("left_of", np.uint16(2))], variant="geometric", region=[region], budget={"batch": np.int32(50)}
    )
    assert taken.json == repose.plan(scene, 1, [("left_of", 2)], variant="geometric", region=[plain], budget={"batch": 50}).json
    with pytest.raises(repose.InvalidArgument):
        repose.plan(scene, 1, [("left_of", 2)], budget={"batch": object()})


def test_placements_are_found_in_their_plan(planned):
    assert [planned.index(placement) for placement in planned] == list(range(len(planned)))
    assert len(set(planned)) == len(planned)


def test_other_threads_run_while_a_plan_is_made(scene):
    ticks, done = [], threading.Event()

    def tick():
        while not done.is_set():
            ticks.append(time.monotonic())
            time.sleep(0.001)

    other = threading.Thread(target=tick)
    other.start()
    started = time.monotonic()
    repose.plan(scene, move=1, goal=[("left_of", 2)], seed=1)
    ended = time.monotonic()
    done.set()
    other.join()
    within = [t for t in ticks if started <= t <= ended]
    longest = max(np.diff([started, *within, ended]))
    assert longest < 0.5 * (ended - started), f"nothing else ran for {longest:.3f} of {ended - started:.3f} s"


def test_plans_made_by_several_threads_at_once_are_the_same(scene, planned):
    answers = [None] * 4

    def one(i):
        answers[i] = repose.plan(scene, move=1, goal=[("left_of", 2), ("not", "near", 3)], count=3, seed=5).json

    threads = [threading.Thread(target=one, args=(i,)) for i in range(len(answers))]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert answers == [planned.json] * 4


def test_weights_that_are_none_are_refused(tmp_path):
    bad = tmp_path / "weights.safetensors"
    bad.write_bytes(b"nothing")
    with pytest.raises(repose.InvalidArgument) as raised:
        repose.Models(weights=bad)
    assert raised.value.field == "weights"


def test_a_goal_in_words_is_the_goal_by_numbers(scene):
    said = repose.plan(scene, say="put the red box to the left of the blue box", seed=5, variant="geometric")
    numbered = repose.plan(scene, move=1, goal=["left_of:2"], seed=5, variant="geometric")
    assert said.json == numbered.json
    assert [(t.phrase, t.object) for t in said.taken] == [("the red box", 1), ("the blue box", 2)]
    with pytest.raises(repose.Unclear) as raised:
        repose.plan(scene, say="put the red box left of the box")
    assert raised.value.candidates == [2, 3]
    assert raised.value.field == "say"
    elsewhere = pickle.loads(pickle.dumps(raised.value))
    assert (str(elsewhere), elsewhere.candidates, elsewhere.field) == (str(raised.value), [2, 3], "say")


def test_the_motion_of_a_placement_is_planned(scene, planned):
    motion = repose.plan_motion(scene, planned, READY_RAD)
    assert 0 <= motion.placement < len(planned)
    assert motion.duration_s > 1.0
    first = motion.phases[0]
    assert first.joints_rad.shape == first.velocities_rad_s.shape == (len(first.times_s), 7)
    np.testing.assert_allclose(first.joints_rad[0], READY_RAD, atol=1e-6)
    again = repose.plan_motion(scene, planned.transforms, READY_RAD, move=1)
    assert again.json == motion.json


def test_motion_without_a_calibrated_camera_is_refused(view, planned):
    floating = view.scene(world_from_camera=None)
    with pytest.raises(repose.FailedPrecondition):
        repose.plan_motion(floating, planned.transforms, READY_RAD, move=1)
    with pytest.raises(repose.InvalidArgument) as raised:
        repose.plan_motion(floating, planned, [0.0] * 6)
    assert raised.value.field == "start_joints_rad"
    for wordy in (["ready"] * 7, [None] * 7):
        with pytest.raises(repose.InvalidArgument) as raised:
            repose.plan_motion(floating, planned, wordy)
        assert raised.value.field == "start_joints_rad"


def test_pictures_show_the_scene_and_the_plan(scene, planned, view):
    seen = repose.picture(scene)
    assert seen.shape == (*view.depth.shape, 3)
    assert seen.flags.writeable, "it can be drawn on"
    both = repose.picture(scene, planned)
    assert both.shape[1] > 2 * seen.shape[1]
    moved = repose.picture(scene, placement=planned[0], move=1)
    assert (moved != repose.picture(scene, by_object=True)).any()


def test_the_first_lines_of_the_readme_plan(view):
    names = {"depth": view.depth, "K": view.camera_matrix, "color": view.color}
    exec(readme_blocks()[0], names)
    assert names["plan"][0].placed_from_observed.shape == (4, 4)

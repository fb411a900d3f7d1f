"""Cameras: geometry in every renderer, exact shapes, repeatable pixels, speed."""

import importlib.util
from typing import Any

import numpy as np
import pytest

from xpl import _spec as spec
from xpl import get_embodiment
from xpl.poses import invert, transform
from xpl_cli.basics.content import content_folder, load_module

mujoco = pytest.importorskip("mujoco")

FOLDER = content_folder("envs") / "mujoco"
FACTS = load_module(FOLDER / "manifest.py").manifest().data
make = load_module(FOLDER / "client.py").make
camera_module = load_module(FOLDER / "camera.py")
renderers = load_module(FOLDER / "renderers.py")
gl = load_module(FOLDER / "gl.py")
load_task = load_module(FOLDER / "task.py").load_task

RENDERERS = FACTS["renderers"]
EYES = [*spec.CAMERAS[2], *spec.OPTIONAL_CAMERAS]
SIZE = (90, 120)


def _env(**config: Any) -> Any:
    return make({"task": "lift_cube", "embodiment": "arx_x5", **config})


def _studio(model: Any, renderer: str) -> Any:
    """Return a studio whose renderer this machine has, or skip."""
    studio = renderers.Studio(model, renderer)
    try:
        studio.camera(model.camera(0).name, (8, 8))
    except gl.RendererMissingError as error:
        pytest.skip(str(error))
    return studio


def _cast(camera: Any, data: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return what MuJoCo's own rays meet at every pixel: geom, and depth along the axis (0: nothing)."""
    inverse = np.linalg.inv(camera.intrinsics)
    columns, rows = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    rays = inverse @ np.stack([columns.ravel(), rows.ravel(), np.ones(columns.size)])
    length = np.linalg.norm(rays, axis=0)
    directions = np.ascontiguousarray((camera.axes(data) @ (rays / length)).T).reshape(-1)
    hit, distance = np.empty(length.size, dtype=np.int32), np.empty(length.size)
    eye = np.array(data.cam_xpos[camera.id])
    mujoco.mj_multiRay(camera.model, data, eye, directions, None, 1, -1, hit, distance, None, length.size, 50.0)
    shape = (camera.height, camera.width)
    return hit.reshape(shape), np.where(hit >= 0, distance / length, 0.0).reshape(shape)


# -- geometry ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("renderer", RENDERERS)
def test_a_known_point_lands_on_its_pixel(renderer: str) -> None:
    """The middle of a small ball's picture is where intrinsics and extrinsics put its centre, within half a pixel.

    And the depth there is that of the ball's near side.
    """
    scene = mujoco.MjSpec()
    scene.worldbody.add_camera(name="eye", pos=[0.2, -1.0, 0.7], quat=[0.85, 0.5, 0.1, 0.05], fovy=65)
    scene.worldbody.add_light(dir=[0, 0, -1])
    ball, radius = scene.worldbody.add_body(name="ball", mocap=True), 0.012
    ball.add_geom(name="ball", type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[radius, 0, 0], rgba=[1, 0, 0, 1])
    scene.worldbody.add_geom(name="floor", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[5, 5, 0.1])
    model = scene.compile()
    data = mujoco.MjData(model)
    studio = _studio(model, renderer)
    camera = studio.camera("eye", (240, 320))
    mujoco.mj_forward(model, data)
    matrix, rng = camera.extrinsics(data), np.random.default_rng(0)
    for _ in range(20):
        pixel, depth = rng.uniform([20, 20], [300, 220]), rng.uniform(0.3, 0.9)
        ray = depth * (np.linalg.inv(camera.intrinsics) @ [*pixel, 1.0])
        data.mocap_pos[0] = matrix[:3, :3].T @ (ray - matrix[:3, 3])
        if data.mocap_pos[0, 2] < 2 * radius:
            continue  # in the floor
        mujoco.mj_forward(model, data)
        frame = camera.render(data)
        rows, columns = np.nonzero(frame.segmentation == model.geom("ball").id)
        assert abs(columns.mean() - pixel[0]) <= 0.5
        assert abs(rows.mean() - pixel[1]) <= 0.5
        middle = frame.depth[round(pixel[1]), round(pixel[0])]
        assert depth - 1.2 * radius <= middle <= depth - 0.6 * radius
        assert frame.color[round(pixel[1]), round(pixel[0])].argmax() == 0
    studio.close()


@pytest.mark.parametrize("renderer", RENDERERS)
@pytest.mark.parametrize("eye", ["cam_head", "cam_left_wrist"])
def test_every_pixel_is_where_projection_puts_it(renderer: str, eye: str) -> None:
    """The block's pixels, back-projected by depth, intrinsics and extrinsics, lie on the block's surface.

    And its corners project to within half a pixel of the rectangle that segmentation shows.
    """
    env = _env(task="handover_block", privileged=True, cameras=[224, 224], renderer=renderer)
    try:
        env.reset([3])
    except gl.RendererMissingError as error:
        pytest.skip(str(error))
    obs = env.get_obs()
    view, truth = obs["vision"][eye], obs["privileged"]
    block = truth["objects"]["block"]
    rows, columns = np.nonzero(truth["segmentation"][eye] == truth["bodies"].index("block"))
    assert len(rows) > 50
    depth = view["depth"][rows, columns].astype(np.float64)
    in_camera = np.linalg.inv(view["intrinsic_matrix"]) @ np.stack([columns, rows, np.ones(len(rows))]) * depth
    to_world = np.linalg.inv(view["extrinsics_matrix"])
    world = (to_world[:3, :3] @ in_camera + to_world[:3, 3:]).T
    local = transform(invert(block["pose"]), world) / block["half_size"]
    off = np.abs(np.abs(local).max(axis=1) - 1.0) * block["half_size"].min()
    assert np.quantile(off, 0.95) < 2e-4  # m; OpenGL may differ on the outline

    signs = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)])
    corners = transform(block["pose"], signs * block["half_size"])
    projected = view["extrinsics_matrix"][:3, :3] @ corners.T + view["extrinsics_matrix"][:3, 3:]
    u, v, _ = view["intrinsic_matrix"] @ projected / projected[2]
    for pixels, exact in ((columns, u), (rows, v)):
        low, high = np.clip([exact.min(), exact.max()], 0, 223)
        # A pixel shows what its centre sees, so the outermost pixel lies between the outline and one pixel inside it:
        # within half a pixel of the middle of that range. OpenGL rounds corners to fractions of a pixel.
        assert abs(pixels.min() - (low + 0.5)) <= 0.5 + 0.01
        assert abs(pixels.max() - (high - 0.5)) <= 0.5 + 0.01
    env.close()


@pytest.mark.parametrize("renderer", RENDERERS[1:])
@pytest.mark.parametrize("eye", EYES)
def test_renderers_agree(renderer: str, eye: str) -> None:
    env = _env(cameras=False)
    env.reset([1])
    physics = env.episodes[0].physics
    ours = camera_module.RayCamera(physics.model, eye, 320, 240).render(physics.data)
    studio = _studio(physics.model, renderer)
    theirs = studio.camera(eye, (240, 320)).render(physics.data)
    same = ours.segmentation == theirs.segmentation
    assert same.mean() > 0.99
    assert np.quantile(np.abs(ours.depth - theirs.depth)[same], 0.99) < 1e-3
    assert theirs.color.std() > 5
    studio.close()


# -- rays --------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("shape", ["SPHERE", "CAPSULE", "CYLINDER", "BOX"])
def test_shapes_are_met_where_mujoco_meets_them(shape: str) -> None:
    """Seen from all sides, along the axes too: geoms equal but for grazing rays, depth to a tenth of a millimetre."""
    scene = mujoco.MjSpec()
    scene.worldbody.add_light(dir=[0, 0, -1])
    scene.worldbody.add_geom(type=getattr(mujoco.mjtGeom, f"mjGEOM_{shape}"), size=[0.1, 0.25, 0.15])
    eye = scene.worldbody.add_body(name="eye", mocap=True)
    eye.add_camera(name="eye", fovy=60)
    model = scene.compile()
    data = mujoco.MjData(model)
    camera, rng = camera_module.RayCamera(model, "eye", 80, 60), np.random.default_rng(0)
    ways = [*np.eye(3), *-np.eye(3), *rng.normal(size=(40, 3))]
    for way in ways:
        back = way / np.linalg.norm(way)
        side = np.cross([0.3, 0.5, 0.8], back)
        side /= np.linalg.norm(side)
        frame = np.stack([side, np.cross(back, side), back], axis=1)
        mujoco.mju_mat2Quat(data.mocap_quat[0], frame.ravel())
        data.mocap_pos[0] = rng.uniform(0.4, 1.0) * back + rng.uniform(-0.1, 0.1, 3)
        mujoco.mj_forward(model, data)
        seen = camera.render(data)
        hit, depth = _cast(camera, data)
        assert (hit >= 0).any()
        same = seen.segmentation == hit
        assert (~same).sum() <= 3
        assert np.quantile(np.abs(seen.depth - depth)[same], 0.999) < 1e-4


@pytest.mark.parametrize("embodiment", ["arx_x5", "piper_x", "franka_single"])
def test_shortcuts_change_no_picture(embodiment: str) -> None:
    """Closed forms in bounding rectangles give the geoms and depths that MuJoCo's rays at everything give."""
    env = _env(embodiment=embodiment, cameras=False)
    env.reset([1])
    physics, robot = env.episodes[0].physics, get_embodiment(embodiment)
    for name in (*robot.cameras, *spec.OPTIONAL_CAMERAS):
        camera = camera_module.RayCamera(physics.model, name, SIZE[1], SIZE[0])
        frame = camera.render(physics.data)
        hit, depth = _cast(camera, physics.data)
        same = frame.segmentation == hit
        assert (~same).mean() < 1e-3
        assert np.quantile(np.abs(frame.depth - depth)[same], 0.999) < 1e-4


def test_pictures_are_repeatable() -> None:
    """A camera that has rendered other scenes, and another camera, render the same state to the same pixels."""
    env = _env(cameras=False)
    env.reset([0])
    physics = env.episodes[0].physics
    cameras = {name: camera_module.RayCamera(physics.model, name, SIZE[1], SIZE[0]) for name in EYES}
    before = {name: camera.render(physics.data) for name, camera in cameras.items()}
    rest = np.array(physics.data.qpos)
    physics.data.qpos[:6] += 0.3
    mujoco.mj_kinematics(physics.model, physics.data)
    mujoco.mj_camlight(physics.model, physics.data)
    moved = cameras["cam_left_wrist"].render(physics.data)
    assert not np.array_equal(moved.color, before["cam_left_wrist"].color)
    physics.data.qpos[:] = rest
    mujoco.mj_kinematics(physics.model, physics.data)
    mujoco.mj_camlight(physics.model, physics.data)
    for name, camera in cameras.items():
        fresh = camera_module.RayCamera(physics.model, name, SIZE[1], SIZE[0])
        for again in (camera.render(physics.data), fresh.render(physics.data)):
            assert again.color.tobytes() == before[name].color.tobytes()
            assert again.depth.tobytes() == before[name].depth.tobytes()


def test_segmentation_names_what_is_seen() -> None:
    """Privileged observations have every pixel's body; the observation's schema does not know such a key."""
    env = _env(cameras=[60, 80], privileged=True)
    env.reset([0])
    truth = env.get_obs()["privileged"]
    assert list(truth["segmentation"]) == list(spec.CAMERAS[2])
    names = {truth["bodies"][index] for image in truth["segmentation"].values() for index in np.unique(image)}
    assert {"world", "cube", "left_link6"} <= names
    assert truth["segmentation"]["cam_head"].dtype == np.int16
    env.reset([0], {"cameras": False})
    assert "segmentation" not in env.get_obs()["privileged"]


OFFERED = [
    (task, embodiment)
    for task, entry in FACTS["tasks"].items()
    for embodiment in ("arx_x5", "piper", "arx_x5_single", "franka_single")
    if len(get_embodiment(embodiment).arms) in entry["arms"] and embodiment not in entry.get("unsupported", {})
]


@pytest.mark.sampled(8)
@pytest.mark.parametrize(("task", "embodiment"), OFFERED)
def test_the_cameras_see_robot_and_objects(task: str, embodiment: str) -> None:
    """Where an episode starts, some camera sees each object that is to be handled, and the head camera a gripper."""
    robot = get_embodiment(embodiment)
    env = _env(task=task, embodiment=embodiment, cameras=[112, 112], privileged=True)
    for seed in range(3):
        env.reset([seed])
        truth = env.get_obs()["privileged"]
        pictures = truth["segmentation"]
        for name in load_task(task).objects:
            index = truth["bodies"].index(name)
            assert max((picture == index).sum() for picture in pictures.values()) > 10, name
        fingers = [truth["bodies"].index(f"{p}finger_{s}") for p in robot.prefixes for s in ("left", "right")]
        assert np.isin(pictures[robot.cameras[0]], fingers).sum() > 20


@pytest.mark.parametrize("embodiment", FACTS["embodiments"])
def test_wrist_cameras_see_fingers_and_table(embodiment: str) -> None:
    """Both fingers of the own arm, side by side, and the table; up in the picture is away from the base."""
    robot = get_embodiment(embodiment)
    env = _env(embodiment=embodiment, cameras=[112, 112], privileged=True)
    env.reset([0])
    obs = env.get_obs()
    truth = obs["privileged"]
    for prefix, camera in zip(robot.prefixes, robot.cameras[1:], strict=True):
        picture = truth["segmentation"][camera]
        columns = [np.nonzero(picture == truth["bodies"].index(f"{prefix}finger_{s}"))[1] for s in ("left", "right")]
        assert min(map(len, columns)) > 200
        assert columns[0].max() < columns[1].min() or columns[1].max() < columns[0].min()
        assert (picture == 0).mean() > 0.4
        up = -obs["vision"][camera]["extrinsics_matrix"][1, :3]
        outward = obs["state"][f"{prefix}ee_pose"][:3] - truth[f"{prefix}base_pose"][:3]
        assert up[:2] @ outward[:2] > 0


# -- errors ------------------------------------------------------------------------------------------------------------


def test_a_shape_without_a_closed_form_is_refused() -> None:
    scene = mujoco.MjSpec()
    scene.worldbody.add_camera(name="eye")
    scene.worldbody.add_geom(name="egg", type=mujoco.mjtGeom.mjGEOM_ELLIPSOID, size=[0.1, 0.2, 0.1])
    with pytest.raises(ValueError, match="'egg'"):
        camera_module.RayCamera(scene.compile(), "eye", 8, 8)


def test_a_second_graphics_library_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """A process renders with one; the error says which, and how to use the other one."""
    monkeypatch.setenv("PYOPENGL_PLATFORM", "egl")
    with pytest.raises(gl.RendererMissingError, match=r"osmesa in this process, which draws with egl.*another one"):
        _env(renderer="osmesa").reset([0])


@pytest.mark.skipif(importlib.util.find_spec("OpenGL") is not None, reason="PyOpenGL is installed here")
def test_a_missing_graphics_library_is_named() -> None:
    """The error names the requirements of OpenGL and the alternative without; the environment still works with rays."""
    env = _env(renderer="egl")
    with pytest.raises(gl.RendererMissingError, match=r"needs PyOpenGL and libEGL.*ray caster needs neither"):
        env.reset([0])
    env = _env(renderer="egl", cameras=False)
    env.reset([0])
    assert env.get_obs()["vision"] == {}

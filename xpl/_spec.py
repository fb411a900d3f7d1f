"""Constants of the standard, generated from version v1.2 of spec/ by `xpl spec compile`. Do not edit.

A key name is reached as an attribute (`Obs.ENV_IDX`), so that a misspelt name fails where it is written.
"""

from __future__ import annotations

from typing import Any


class Obs:
    """Names of the standard."""

    DATA_FORMAT_VERSION = "data_format_version"
    INSTRUCTION = "instruction"
    INSTRUCTIONS = "instructions"
    ENV_IDX = "env_idx"
    ADDITIONAL_INFO = "additional_info"
    VISION = "vision"
    STATE = "state"
    PRIVILEGED = "privileged"
    FREQUENCY = "frequency"


class Camera:
    """Names of the standard."""

    COLOR = "color"
    DEPTH = "depth"
    INTRINSIC_MATRIX = "intrinsic_matrix"
    EXTRINSICS_MATRIX = "extrinsics_matrix"
    SHAPE = "shape"


class State:
    """Names of the standard."""

    ARM_JOINT_STATE = "arm_joint_state"
    EE_JOINT_STATE = "ee_joint_state"
    EE_POSE = "ee_pose"
    TCP_POSE = "tcp_pose"
    DELTA_EE_POSE = "delta_ee_pose"
    MOBILE = "mobile"
    BASE_POSE = "base_pose"
    BASE_TWIST = "base_twist"


class Deploy:
    """Names of the standard."""

    POLICY_NAME = "policy_name"
    PROTOCOL = "protocol"
    HOST = "host"
    PORT = "port"
    BENCH_NAME = "bench_name"
    TASK_NAME = "task_name"
    ENV_CFG_TYPE = "env_cfg_type"
    SEED = "seed"
    ACTION_TYPE = "action_type"
    EVAL_BATCH = "eval_batch"
    CKPT_NAME = "ckpt_name"
    GPU_ID = "gpu_id"
    REQUEST_TIMEOUT_S = "request_timeout_s"
    HANDSHAKE_TIMEOUT_S = "handshake_timeout_s"
    CONNECT_TIMEOUT_S = "connect_timeout_s"
    MAX_CONNECT_ATTEMPTS = "max_connect_attempts"
    CONNECT_RETRY_DELAY_S = "connect_retry_delay_s"
    MAX_CONNECT_SECONDS = "max_connect_seconds"
    WS_PING_INTERVAL_S = "ws_ping_interval_s"
    WS_PING_TIMEOUT_S = "ws_ping_timeout_s"
    CLOSE_TIMEOUT_S = "close_timeout_s"


class File:
    """Names of the standard."""

    README_MD = "README.md"
    INIT_PY = "__init__.py"
    INSTALL_SH = "install.sh"
    EVAL_SH = "eval.sh"
    SETUP_EVAL_POLICY_SERVER_SH = "setup_eval_policy_server.sh"
    SETUP_EVAL_ENV_CLIENT_SH = "setup_eval_env_client.sh"
    DEPLOY_YML = "deploy.yml"
    DEPLOY_PY = "deploy.py"
    MODEL_PY = "model.py"
    PROCESS_DATA_SH = "process_data.sh"
    TRAIN_SH = "train.sh"
    POLICY_YML = "policy.yml"


class Frame:
    """Names of the standard."""

    MESSAGE_TYPE = "message_type"
    MESSAGE_ID = "message_id"
    EVALUATION_ID = "evaluation_id"
    ACTION_CASE_ID = "action_case_id"
    TRIAL_ID = "trial_id"
    REPEAT_INDEX = "repeat_index"
    STEP = "step"
    SENT_AT = "sent_at"
    PAYLOAD = "payload"


class Message:
    """Names of the standard."""

    HELLO = "hello"
    PREPARE_CASE = "prepare_case"
    RESET = "reset"
    INFER = "infer"
    CALL = "call"
    TRIAL_END = "trial_end"
    HEARTBEAT = "heartbeat"
    CLOSE = "close"
    HELLO_ACK = "hello_ack"
    PREPARE_CASE_ACK = "prepare_case_ack"
    RESET_RESULT = "reset_result"
    INFER_RESULT = "infer_result"
    CALL_RESULT = "call_result"
    TRIAL_END_ACK = "trial_end_ack"
    HEARTBEAT_ACK = "heartbeat_ack"
    ERROR = "error"


class Payload:
    """Names of the standard."""

    ACTION_CASE_ID = "action_case_id"
    ACTIONS = "actions"
    CAPABILITIES = "capabilities"
    CODE = "code"
    DETAILS = "details"
    ENVIRONMENT = "environment"
    EVALUATION_PLAN = "evaluation_plan"
    FUNC_NAME = "func_name"
    LATENCY_MS = "latency_ms"
    MESSAGE = "message"
    OBS = "obs"
    OBSERVATION = "observation"
    OK = "ok"
    PACKED = "packed"
    POLICY = "policy"
    PROGRESS = "progress"
    RESULT = "result"
    SEQUENCE = "sequence"
    SERVER = "server"
    SERVER_INSTANCE_ID = "server_instance_id"
    STATE = "state"
    TRIAL_ID = "trial_id"


class ErrorCode:
    """Names of the standard."""

    INVALID_FRAME = "invalid_frame"
    UNKNOWN_MESSAGE_TYPE = "unknown_message_type"
    TIMEOUT = "timeout"
    CALL_FAILED = "call_failed"
    INFER_FAILED = "infer_failed"
    RESET_FAILED = "reset_failed"
    INTERNAL = "internal"


class ErrorReason:
    """Names of the standard."""

    BUSY = "busy"
    LOADING = "loading"
    SHUTTING_DOWN = "shutting_down"
    WORKER_DIED = "worker_died"
    MISMATCH = "mismatch"
    DUPLICATE_ID = "duplicate_id"
    NO_EPISODE = "no_episode"
    OUT_OF_ORDER = "out_of_order"
    UNREADABLE = "unreadable"


class Capability:
    """Names of the standard."""

    WIRE_VERSION = "wire_version"
    JPEG_MARKER = "jpeg_marker"
    LOADING = "loading"
    PACKED = "packed"
    SEQUENCE = "sequence"
    SHARED_MEMORY = "shared_memory"
    SESSION = "session"
    JPEG = "jpeg"


class ServerState:
    """Names of the standard."""

    LOADING = "loading"
    READY = "ready"
    DRAINING = "draining"


class Method:
    """Names of the standard."""

    UPDATE_OBS = "update_obs"
    UPDATE_OBS_BATCH = "update_obs_batch"
    GET_ACTION = "get_action"
    GET_ACTION_BATCH = "get_action_batch"
    RESET = "reset"
    PREPARE_CASE = "prepare_case"
    ON_TRIAL_END = "on_trial_end"
    INFER = "infer"
    RESET_ENVS = "reset_envs"


SPEC_VERSION: str = 'v1.2'
DATA_FORMAT_VERSION: str = 'v1.0'
WIRE_VERSION: int = 1
ARM_PREFIXES: dict[int, tuple[str, ...]] = {1: ('',), 2: ('left_', 'right_')}
ACTION_TYPES: tuple[str, ...] = ('joint', 'ee')
ACTION_KEYS: dict[str, tuple[str, ...]] = {'joint': ('arm_joint_state', 'ee_joint_state'), 'ee': ('ee_pose', 'ee_joint_state')}
POSE_DIM: int = 7
POSITION_DIM: int = 3
TWIST_DIM: int = 6
COLOR_CHANNELS: int = 3
QUATERNION_TOLERANCE: float = 0.001
QUATERNION_REPAIR: float = 0.5
GRIPPER_OVERSHOOT: float = 0.5
GRIPPER_CLOSED: float = 0.0
GRIPPER_OPEN: float = 1.0
CAMERAS: dict[int, tuple[str, ...]] = {1: ('cam_head', 'cam_wrist'), 2: ('cam_head', 'cam_left_wrist', 'cam_right_wrist')}
OPTIONAL_CAMERAS: tuple[str, ...] = ('cam_third_view',)
READ_ALIASES: dict[str, tuple[str, ...]] = {'color': ('colors', 'rgb', 'image'), 'extrinsics_matrix': ('extrinsic_matrix',), 'instruction': ('instructions',)}
JPEG_MARKER: bytes = b'XPL-RGB1'
JOINT_TOLERANCE: float = 0.001
POSITION_TOLERANCE: float = 0.001
JOINT_SPEED: float = 6.3
POSITION_SPEED: float = 2.5
ROTATION_SPEED: float = 6.3
CHECKPOINT_DIRECTORY: str = 'checkpoints'
CHECKPOINT_RUN_NAME: tuple[str, ...] = ('bench_name', 'ckpt_name', 'env_cfg_type', 'action_type', 'seed')
CHECKPOINT_KEYS: tuple[str, ...] = ('model_path', 'checkpoint_path', 'ckpt_path', 'model_dir', 'pretrained_path')
CONFIG_ALIASES: dict[str, tuple[str, ...]] = {'bench_name': ('dataset_name',)}
DEPLOY_DEFAULTS: dict[str, Any] = {'protocol': 'ws',
 'host': 'localhost',
 'port': None,
 'bench_name': None,
 'task_name': None,
 'env_cfg_type': None,
 'seed': 0,
 'action_type': 'joint',
 'eval_batch': False,
 'ckpt_name': None,
 'gpu_id': None,
 'request_timeout_s': 120,
 'handshake_timeout_s': 60,
 'connect_timeout_s': 30,
 'max_connect_attempts': 180,
 'connect_retry_delay_s': 5,
 'max_connect_seconds': 900,
 'ws_ping_interval_s': 20,
 'ws_ping_timeout_s': 20,
 'close_timeout_s': 10}
MODEL_CLASS: str = 'Model'
ANSWERS: dict[str, Any] = {'hello': 'hello_ack',
 'prepare_case': 'prepare_case_ack',
 'reset': 'reset_result',
 'infer': 'infer_result',
 'call': 'call_result',
 'trial_end': 'trial_end_ack',
 'heartbeat': 'heartbeat_ack',
 'close': None}
CONTRACT_METHODS: tuple[str, ...] = ('update_obs', 'update_obs_batch', 'get_action', 'get_action_batch', 'reset')
HOOKS: tuple[str, ...] = ('prepare_case', 'on_trial_end')
ARRAY_KEYS: dict[str, bytes] = {'nd': b'nd', 'type': b'type', 'kind': b'kind', 'shape': b'shape', 'data': b'data', 'complex': b'complex'}
STRUCTURED_KIND: bytes = b'V'
LIMITS: dict[str, int] = {'frame_bytes': 268435456,
 'nesting': 32,
 'elements': 4194304,
 'packed_header': 1048576,
 'replay_entries': 256,
 'replay_bytes': 67108864,
 'connections': 256,
 'pending': 64,
 'pending_bytes': 67108864,
 'fragments': 65536,
 'pipelined': 8,
 'shared_array': 16384,
 'shared_bytes': 1073741824,
 'clients': 64,
 'client_envs': 4096}
SHARED_MEMORY: dict[str, int] = {'token_bytes': 16, 'states_at': 64, 'blocks': 1024, 'data_at': 4096, 'free': 0, 'sent': 1, 'taken': 2}
CLOSE_CODES: dict[str, int] = {'server_failed': 4011, 'replaced': 4009, 'no_hello': 4008}
EMBODIMENTS: dict[str, dict[str, Any]] = {'aloha_agilex': {'name': 'aloha_agilex',
                  'aliases': [],
                  'description': 'ALOHA-class bimanual platform of AgileX, six joints and a parallel gripper an '
                                 'arm.',
                  'arms': ['left', 'right'],
                  'arm': {'dof': 6,
                          'home': [0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
                          'base_mass': 0.44038,
                          'joints': [{'name': 'joint1',
                                      'limits': [-3.14, 2.618],
                                      'urdf_limits': [-10.0, 10.0],
                                      'velocity': 5.0,
                                      'effort': 30.0,
                                      'mass': 0.060835,
                                      'origin': {'xyz': [0.0, 0.0, 0.0603], 'rpy': [0.0, 0.0, 0.0]},
                                      'axis': [0.0, 0.0, 1.0]},
                                     {'name': 'joint2',
                                      'limits': [-0.05, 3.5],
                                      'urdf_limits': [-10.0, 10.0],
                                      'velocity': 5.0,
                                      'effort': 40.0,
                                      'mass': 1.073328,
                                      'origin': {'xyz': [0.02, 0.0, 0.0402], 'rpy': [0.0, 0.0, 0.0]},
                                      'axis': [0.0, 1.0, 0.0]},
                                     {'name': 'joint3',
                                      'limits': [-0.1, 3.2],
                                      'urdf_limits': [-10.0, 10.0],
                                      'velocity': 5.5,
                                      'effort': 30.0,
                                      'mass': 0.499405,
                                      'origin': {'xyz': [-0.264, 0.0, 0.0], 'rpy': [-3.14159265, 0.0, 0.0]},
                                      'axis': [0.0, 1.0, 0.0]},
                                     {'name': 'joint4',
                                      'limits': [-1.6, 1.55],
                                      'urdf_limits': [-10.0, 10.0],
                                      'velocity': 5.5,
                                      'effort': 15.0,
                                      'mass': 0.080971,
                                      'origin': {'xyz': [0.245, 0.0, -0.056], 'rpy': [0.0, 0.0, 0.0]},
                                      'axis': [0.0, 1.0, 0.0]},
                                     {'name': 'joint5',
                                      'limits': [-1.57, 1.57],
                                      'urdf_limits': [-10.0, 10.0],
                                      'velocity': 5.0,
                                      'effort': 10.0,
                                      'mass': 0.602357,
                                      'origin': {'xyz': [0.06575, -0.001, -0.0825], 'rpy': [0.0, 0.0, 0.0]},
                                      'axis': [0.0, 0.0, 1.0]},
                                     {'name': 'joint6',
                                      'limits': [-2.0, 2.0],
                                      'urdf_limits': [-10.0, 10.0],
                                      'velocity': 5.0,
                                      'effort': 10.0,
                                      'mass': 0.462245,
                                      'origin': {'xyz': [0.02845, 0.0, 0.0825], 'rpy': [-3.14159265, 0.0, 0.0]},
                                      'axis': [1.0, 0.0, 0.0]}]},
                  'end_effector': {'kind': 'parallel_gripper',
                                   'dim': 1,
                                   'stroke': 0.0953,
                                   'finger_range': [0.0, 0.04765],
                                   'finger_origin': [0.073574, 0.024629, 0.0],
                                   'velocity': 0.3,
                                   'effort': None,
                                   'tcp': {'xyz': [0.145, 0.0, 0.0], 'rpy': [0.0, 0.0, 0.0]},
                                   'forward_axis': [1.0, 0.0, 0.0],
                                   'slide_axis': [0.0, 1.0, 0.0]},
                  'mounts': {'left': {'xyz': [-0.3, -0.45, 0.765], 'quaternion': [0.7071068, 0.0, 0.0, 0.7071068]},
                             'right': {'xyz': [0.307, -0.45, 0.765],
                                       'quaternion': [0.7071068, 0.0, 0.0, 0.7071068]}},
                  'sources': ['agilexrobotics/mobile_aloha_sim arx5_description_isaac.urdf at 9085f5ed, front '
                              'arms: joint frames, masses, finger travel and origin, distance between the arms',
                              'real-stanford/arx5-sdk include/app/config.h (MIT), for the arm of the same frames: '
                              'deployed limits, speeds, torques',
                              'google-deepmind/mujoco_menagerie arx_l5 (BSD-3-Clause): finger speed, tcp'],
                  'caveats': ['The front arms only; the description also has a mobile base and two leading arms.',
                              'urdf_limits, as all limits of the description, are placeholders; limits, velocity '
                              'and effort are those of the ARX X5, whose joint frames are the same.',
                              'In the description the arms stand on the platform 0.7775 m over the floor; the '
                              'mounts here keep their distance from each other and put them at the table of the '
                              'other robots.',
                              'The joints are named fl_joint1 to fl_joint6 and fr_joint1 to fr_joint6 there.',
                              "The force of the gripper is not published; tcp is the X5's, given as a point, its "
                              'frame parallel to the flange.']},
 'aloha_agilex_single': {'name': 'aloha_agilex_single',
                         'aliases': [],
                         'description': 'One arm of the ALOHA-class platform of AgileX, six joints and a parallel '
                                        'gripper.',
                         'arms': ['single'],
                         'arm': {'dof': 6,
                                 'home': [0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
                                 'base_mass': 0.44038,
                                 'joints': [{'name': 'joint1',
                                             'limits': [-3.14, 2.618],
                                             'urdf_limits': [-10.0, 10.0],
                                             'velocity': 5.0,
                                             'effort': 30.0,
                                             'mass': 0.060835,
                                             'origin': {'xyz': [0.0, 0.0, 0.0603], 'rpy': [0.0, 0.0, 0.0]},
                                             'axis': [0.0, 0.0, 1.0]},
                                            {'name': 'joint2',
                                             'limits': [-0.05, 3.5],
                                             'urdf_limits': [-10.0, 10.0],
                                             'velocity': 5.0,
                                             'effort': 40.0,
                                             'mass': 1.073328,
                                             'origin': {'xyz': [0.02, 0.0, 0.0402], 'rpy': [0.0, 0.0, 0.0]},
                                             'axis': [0.0, 1.0, 0.0]},
                                            {'name': 'joint3',
                                             'limits': [-0.1, 3.2],
                                             'urdf_limits': [-10.0, 10.0],
                                             'velocity': 5.5,
                                             'effort': 30.0,
                                             'mass': 0.499405,
                                             'origin': {'xyz': [-0.264, 0.0, 0.0], 'rpy': [-3.14159265, 0.0, 0.0]},
                                             'axis': [0.0, 1.0, 0.0]},
                                            {'name': 'joint4',
                                             'limits': [-1.6, 1.55],
                                             'urdf_limits': [-10.0, 10.0],
                                             'velocity': 5.5,
                                             'effort': 15.0,
                                             'mass': 0.080971,
                                             'origin': {'xyz': [0.245, 0.0, -0.056], 'rpy': [0.0, 0.0, 0.0]},
                                             'axis': [0.0, 1.0, 0.0]},
                                            {'name': 'joint5',
                                             'limits': [-1.57, 1.57],
                                             'urdf_limits': [-10.0, 10.0],
                                             'velocity': 5.0,
                                             'effort': 10.0,
                                             'mass': 0.602357,
                                             'origin': {'xyz': [0.06575, -0.001, -0.0825], 'rpy': [0.0, 0.0, 0.0]},
                                             'axis': [0.0, 0.0, 1.0]},
                                            {'name': 'joint6',
                                             'limits': [-2.0, 2.0],
                                             'urdf_limits': [-10.0, 10.0],
                                             'velocity': 5.0,
                                             'effort': 10.0,
                                             'mass': 0.462245,
                                             'origin': {'xyz': [0.02845, 0.0, 0.0825],
                                                        'rpy': [-3.14159265, 0.0, 0.0]},
                                             'axis': [1.0, 0.0, 0.0]}]},
                         'end_effector': {'kind': 'parallel_gripper',
                                          'dim': 1,
                                          'stroke': 0.0953,
                                          'finger_range': [0.0, 0.04765],
                                          'finger_origin': [0.073574, 0.024629, 0.0],
                                          'velocity': 0.3,
                                          'effort': None,
                                          'tcp': {'xyz': [0.145, 0.0, 0.0], 'rpy': [0.0, 0.0, 0.0]},
                                          'forward_axis': [1.0, 0.0, 0.0],
                                          'slide_axis': [0.0, 1.0, 0.0]},
                         'mounts': {'left': {'xyz': [-0.3, -0.45, 0.765],
                                             'quaternion': [0.7071068, 0.0, 0.0, 0.7071068]},
                                    'right': {'xyz': [0.307, -0.45, 0.765],
                                              'quaternion': [0.7071068, 0.0, 0.0, 0.7071068]}},
                         'sources': ['agilexrobotics/mobile_aloha_sim arx5_description_isaac.urdf at 9085f5ed, '
                                     'front arms: joint frames, masses, finger travel and origin, distance between '
                                     'the arms',
                                     'real-stanford/arx5-sdk include/app/config.h (MIT), for the arm of the same '
                                     'frames: deployed limits, speeds, torques',
                                     'google-deepmind/mujoco_menagerie arx_l5 (BSD-3-Clause): finger speed, tcp'],
                         'caveats': ['The front arms only; the description also has a mobile base and two leading '
                                     'arms.',
                                     'urdf_limits, as all limits of the description, are placeholders; limits, '
                                     'velocity and effort are those of the ARX X5, whose joint frames are the '
                                     'same.',
                                     'In the description the arms stand on the platform 0.7775 m over the floor; '
                                     'the mounts here keep their distance from each other and put them at the '
                                     'table of the other robots.',
                                     'The joints are named fl_joint1 to fl_joint6 and fr_joint1 to fr_joint6 '
                                     'there.',
                                     "The force of the gripper is not published; tcp is the X5's, given as a "
                                     'point, its frame parallel to the flange.']},
 'arx_x5': {'name': 'arx_x5',
            'aliases': ['dual_x5'],
            'description': 'Two ARX X5 arms of six joints with parallel grippers, side by side at a table.',
            'arms': ['left', 'right'],
            'arm': {'dof': 6,
                    'home': [0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
                    'base_mass': 0.428,
                    'joints': [{'name': 'joint1',
                                'limits': [-3.14, 2.618],
                                'urdf_limits': [-10.0, 10.0],
                                'velocity': 5.0,
                                'effort': 30.0,
                                'mass': 0.064,
                                'origin': {'xyz': [0.0, 0.0, 0.0603], 'rpy': [0.0, 0.0, 0.0]},
                                'axis': [0.0, 0.0, 1.0]},
                               {'name': 'joint2',
                                'limits': [-0.05, 3.5],
                                'urdf_limits': [0.0, 3.14],
                                'velocity': 5.0,
                                'effort': 40.0,
                                'mass': 1.165,
                                'origin': {'xyz': [0.02, 0.0, 0.0402], 'rpy': [0.0, 0.0, 0.0]},
                                'axis': [0.0, 1.0, 0.0]},
                               {'name': 'joint3',
                                'limits': [-0.1, 3.2],
                                'urdf_limits': [0.0, 3.14],
                                'velocity': 5.5,
                                'effort': 30.0,
                                'mass': 0.546,
                                'origin': {'xyz': [-0.264, 0.0, 0.0], 'rpy': [-3.14159265, 0.0, 0.0]},
                                'axis': [0.0, 1.0, 0.0]},
                               {'name': 'joint4',
                                'limits': [-1.6, 1.55],
                                'urdf_limits': [-1.5708, 1.5708],
                                'velocity': 5.5,
                                'effort': 15.0,
                                'mass': 0.080971,
                                'origin': {'xyz': [0.245, 0.0, -0.056], 'rpy': [0.0, 0.0, 0.0]},
                                'axis': [0.0, 1.0, 0.0]},
                               {'name': 'joint5',
                                'limits': [-1.57, 1.57],
                                'urdf_limits': [-1.67, 1.67],
                                'velocity': 5.0,
                                'effort': 10.0,
                                'mass': 0.655,
                                'origin': {'xyz': [0.06575, -0.001, -0.0825], 'rpy': [0.0, 0.0, 0.0]},
                                'axis': [0.0, 0.0, 1.0]},
                               {'name': 'joint6',
                                'limits': [-2.0, 2.0],
                                'urdf_limits': [-1.57, 1.57],
                                'velocity': 5.0,
                                'effort': 10.0,
                                'mass': 0.581,
                                'origin': {'xyz': [0.02845, 0.0, 0.0825], 'rpy': [-3.14159265, 0.0, 0.0]},
                                'axis': [1.0, 0.0, 0.0]}]},
            'end_effector': {'kind': 'parallel_gripper',
                             'dim': 1,
                             'stroke': 0.088,
                             'finger_range': [0.0, 0.044],
                             'finger_origin': [0.08657, 0.0249, 0.0],
                             'velocity': 0.3,
                             'effort': None,
                             'tcp': {'xyz': [0.145, 0.0, 0.0], 'rpy': [0.0, 0.0, 0.0]},
                             'forward_axis': [1.0, 0.0, 0.0],
                             'slide_axis': [0.0, 1.0, 0.0]},
            'mounts': {'left': {'xyz': [-0.3, -0.45, 0.765], 'quaternion': [0.7071068, 0.0, 0.0, 0.7071068]},
                       'right': {'xyz': [0.3, -0.45, 0.765], 'quaternion': [0.7071068, 0.0, 0.0, 0.7071068]}},
            'sources': ['real-stanford/arx5-sdk models/X5.urdf and include/app/config.h (MIT): joint frames, '
                        'masses, deployed limits, speeds, torques',
                        'google-deepmind/mujoco_menagerie arx_l5 (BSD-3-Clause): finger travel and origin',
                        'RoboTwin / RoboDojo env_cfg/robot/dual_x5.yml and scene/datagen.yml: mounts'],
            'caveats': ['limits, velocity and effort of the joints are those the SDK deploys; urdf_limits are the '
                        "description's own, placeholders in places (joint1).",
                        "The description has no fingers: finger travel and origin are the L5's.",
                        'The force of the gripper is not published (a 1.5 N m motor).',
                        'home is the zero pose, arms folded on the base.',
                        'tcp is given as a point; its frame is parallel to the flange.']},
 'arx_x5_single': {'name': 'arx_x5_single',
                   'aliases': [],
                   'description': 'One ARX X5 arm of six joints with a parallel gripper.',
                   'arms': ['single'],
                   'arm': {'dof': 6,
                           'home': [0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
                           'base_mass': 0.428,
                           'joints': [{'name': 'joint1',
                                       'limits': [-3.14, 2.618],
                                       'urdf_limits': [-10.0, 10.0],
                                       'velocity': 5.0,
                                       'effort': 30.0,
                                       'mass': 0.064,
                                       'origin': {'xyz': [0.0, 0.0, 0.0603], 'rpy': [0.0, 0.0, 0.0]},
                                       'axis': [0.0, 0.0, 1.0]},
                                      {'name': 'joint2',
                                       'limits': [-0.05, 3.5],
                                       'urdf_limits': [0.0, 3.14],
                                       'velocity': 5.0,
                                       'effort': 40.0,
                                       'mass': 1.165,
                                       'origin': {'xyz': [0.02, 0.0, 0.0402], 'rpy': [0.0, 0.0, 0.0]},
                                       'axis': [0.0, 1.0, 0.0]},
                                      {'name': 'joint3',
                                       'limits': [-0.1, 3.2],
                                       'urdf_limits': [0.0, 3.14],
                                       'velocity': 5.5,
                                       'effort': 30.0,
                                       'mass': 0.546,
                                       'origin': {'xyz': [-0.264, 0.0, 0.0], 'rpy': [-3.14159265, 0.0, 0.0]},
                                       'axis': [0.0, 1.0, 0.0]},
                                      {'name': 'joint4',
                                       'limits': [-1.6, 1.55],
                                       'urdf_limits': [-1.5708, 1.5708],
                                       'velocity': 5.5,
                                       'effort': 15.0,
                                       'mass': 0.080971,
                                       'origin': {'xyz': [0.245, 0.0, -0.056], 'rpy': [0.0, 0.0, 0.0]},
                                       'axis': [0.0, 1.0, 0.0]},
                                      {'name': 'joint5',
                                       'limits': [-1.57, 1.57],
                                       'urdf_limits': [-1.67, 1.67],
                                       'velocity': 5.0,
                                       'effort': 10.0,
                                       'mass': 0.655,
                                       'origin': {'xyz': [0.06575, -0.001, -0.0825], 'rpy': [0.0, 0.0, 0.0]},
                                       'axis': [0.0, 0.0, 1.0]},
                                      {'name': 'joint6',
                                       'limits': [-2.0, 2.0],
                                       'urdf_limits': [-1.57, 1.57],
                                       'velocity': 5.0,
                                       'effort': 10.0,
                                       'mass': 0.581,
                                       'origin': {'xyz': [0.02845, 0.0, 0.0825], 'rpy': [-3.14159265, 0.0, 0.0]},
                                       'axis': [1.0, 0.0, 0.0]}]},
                   'end_effector': {'kind': 'parallel_gripper',
                                    'dim': 1,
                                    'stroke': 0.088,
                                    'finger_range': [0.0, 0.044],
                                    'finger_origin': [0.08657, 0.0249, 0.0],
                                    'velocity': 0.3,
                                    'effort': None,
                                    'tcp': {'xyz': [0.145, 0.0, 0.0], 'rpy': [0.0, 0.0, 0.0]},
                                    'forward_axis': [1.0, 0.0, 0.0],
                                    'slide_axis': [0.0, 1.0, 0.0]},
                   'mounts': {'left': {'xyz': [-0.3, -0.45, 0.765], 'quaternion': [0.7071068, 0.0, 0.0, 0.7071068]},
                              'right': {'xyz': [0.3, -0.45, 0.765],
                                        'quaternion': [0.7071068, 0.0, 0.0, 0.7071068]}},
                   'sources': ['real-stanford/arx5-sdk models/X5.urdf and include/app/config.h (MIT): joint '
                               'frames, masses, deployed limits, speeds, torques',
                               'google-deepmind/mujoco_menagerie arx_l5 (BSD-3-Clause): finger travel and origin',
                               'RoboTwin / RoboDojo env_cfg/robot/dual_x5.yml and scene/datagen.yml: mounts'],
                   'caveats': ['limits, velocity and effort of the joints are those the SDK deploys; urdf_limits '
                               "are the description's own, placeholders in places (joint1).",
                               "The description has no fingers: finger travel and origin are the L5's.",
                               'The force of the gripper is not published (a 1.5 N m motor).',
                               'home is the zero pose, arms folded on the base.',
                               'tcp is given as a point; its frame is parallel to the flange.']},
 'fetch': {'name': 'fetch',
           'aliases': [],
           'description': 'The seven-joint arm of a Fetch mobile manipulator with its parallel gripper, on a base '
                          'that stands still.',
           'arms': ['single'],
           'arm': {'dof': 7, 'home': None, 'base_mass': None, 'joints': None},
           'end_effector': {'kind': 'parallel_gripper',
                            'dim': 1,
                            'stroke': 0.1,
                            'finger_range': None,
                            'finger_origin': None,
                            'velocity': None,
                            'effort': None,
                            'tcp': None,
                            'forward_axis': None,
                            'slide_axis': None},
           'mounts': None,
           'sources': ['Farama-Foundation/Gymnasium-Robotics envs/assets/fetch/robot.xml (MIT): number of joints, '
                       'finger travel'],
           'caveats': ["Dimensions only, for control by the flange's pose. Three of the joints turn without end, "
                       'so that there are no limits to give for them.']},
 'franka': {'name': 'franka',
            'aliases': [],
            'description': "Two Franka arms of seven joints with parallel grippers, as the field's registry counts "
                           'this name.',
            'arms': ['left', 'right'],
            'arm': {'dof': 7,
                    'home': [0.0, 0.0, 0.0, -1.57079, 0.0, 1.57079, -0.7853],
                    'base_mass': 0.629769,
                    'joints': [{'name': 'joint1',
                                'limits': [-2.8973, 2.8973],
                                'urdf_limits': [-2.8973, 2.8973],
                                'velocity': 2.175,
                                'effort': 87.0,
                                'mass': 4.970684,
                                'origin': {'xyz': [0.0, 0.0, 0.333], 'rpy': [0.0, 0.0, 0.0]},
                                'axis': [0.0, 0.0, 1.0]},
                               {'name': 'joint2',
                                'limits': [-1.7628, 1.7628],
                                'urdf_limits': [-1.7628, 1.7628],
                                'velocity': 2.175,
                                'effort': 87.0,
                                'mass': 0.646926,
                                'origin': {'xyz': [0.0, 0.0, 0.0], 'rpy': [-1.57079633, 0.0, 0.0]},
                                'axis': [0.0, 0.0, 1.0]},
                               {'name': 'joint3',
                                'limits': [-2.8973, 2.8973],
                                'urdf_limits': [-2.8973, 2.8973],
                                'velocity': 2.175,
                                'effort': 87.0,
                                'mass': 3.228604,
                                'origin': {'xyz': [0.0, -0.316, 0.0], 'rpy': [1.57079633, 0.0, 0.0]},
                                'axis': [0.0, 0.0, 1.0]},
                               {'name': 'joint4',
                                'limits': [-3.0718, -0.0698],
                                'urdf_limits': [-3.0718, -0.0698],
                                'velocity': 2.175,
                                'effort': 87.0,
                                'mass': 3.587895,
                                'origin': {'xyz': [0.0825, 0.0, 0.0], 'rpy': [1.57079633, 0.0, 0.0]},
                                'axis': [0.0, 0.0, 1.0]},
                               {'name': 'joint5',
                                'limits': [-2.8973, 2.8973],
                                'urdf_limits': [-2.8973, 2.8973],
                                'velocity': 2.61,
                                'effort': 12.0,
                                'mass': 1.225946,
                                'origin': {'xyz': [-0.0825, 0.384, 0.0], 'rpy': [-1.57079633, 0.0, 0.0]},
                                'axis': [0.0, 0.0, 1.0]},
                               {'name': 'joint6',
                                'limits': [-0.0175, 3.7525],
                                'urdf_limits': [-0.0175, 3.7525],
                                'velocity': 2.61,
                                'effort': 12.0,
                                'mass': 1.666555,
                                'origin': {'xyz': [0.0, 0.0, 0.0], 'rpy': [1.57079633, 0.0, 0.0]},
                                'axis': [0.0, 0.0, 1.0]},
                               {'name': 'joint7',
                                'limits': [-2.8973, 2.8973],
                                'urdf_limits': [-2.8973, 2.8973],
                                'velocity': 2.61,
                                'effort': 12.0,
                                'mass': 0.735522,
                                'origin': {'xyz': [0.088, -0.107, 0.0], 'rpy': [1.57079633, 0.0, 0.0]},
                                'axis': [0.0, 0.0, 1.0]}]},
            'end_effector': {'kind': 'parallel_gripper',
                             'dim': 1,
                             'stroke': 0.08,
                             'finger_range': [0.0, 0.04],
                             'finger_origin': [0.0, 0.0, 0.0584],
                             'velocity': 0.2,
                             'effort': 20.0,
                             'tcp': {'xyz': [0.0, 0.0, 0.1034], 'rpy': [0.0, 0.0, -0.78539816]},
                             'forward_axis': [0.0, 0.0, 1.0],
                             'slide_axis': [-0.70710678, -0.70710678, 0.0]},
            'mounts': {'left': {'xyz': [-0.3, -0.55, 0.765], 'quaternion': [0.7071068, 0.0, 0.0, 0.7071068]},
                       'right': {'xyz': [0.3, -0.55, 0.765], 'quaternion': [0.7071068, 0.0, 0.0, 0.7071068]}},
            'sources': ['google-deepmind/mujoco_menagerie franka_emika_panda at 1b428b08 (Apache-2.0): joint '
                        'frames, limits, torques, masses, finger travel, home',
                        'frankaemika/franka_ros franka_description (Apache-2.0): speeds, finger speed and force, '
                        'tcp'],
            'caveats': ['The Panda (FER); the FR3 has other limits.',
                        "joint7's frame is slid 107 mm along its own axis to the flange, which changes no motion.",
                        "The hand is turned by -45 degrees about the flange's z axis, and the tcp's frame with it.",
                        "No maker's scene mounts two of these arms at a table: the mounts are this standard's, "
                        "farther from the table's middle than those of the smaller arms."]},
 'franka_single': {'name': 'franka_single',
                   'aliases': [],
                   'description': 'One Franka arm of seven joints with a parallel gripper.',
                   'arms': ['single'],
                   'arm': {'dof': 7,
                           'home': [0.0, 0.0, 0.0, -1.57079, 0.0, 1.57079, -0.7853],
                           'base_mass': 0.629769,
                           'joints': [{'name': 'joint1',
                                       'limits': [-2.8973, 2.8973],
                                       'urdf_limits': [-2.8973, 2.8973],
                                       'velocity': 2.175,
                                       'effort': 87.0,
                                       'mass': 4.970684,
                                       'origin': {'xyz': [0.0, 0.0, 0.333], 'rpy': [0.0, 0.0, 0.0]},
                                       'axis': [0.0, 0.0, 1.0]},
                                      {'name': 'joint2',
                                       'limits': [-1.7628, 1.7628],
                                       'urdf_limits': [-1.7628, 1.7628],
                                       'velocity': 2.175,
                                       'effort': 87.0,
                                       'mass': 0.646926,
                                       'origin': {'xyz': [0.0, 0.0, 0.0], 'rpy': [-1.57079633, 0.0, 0.0]},
                                       'axis': [0.0, 0.0, 1.0]},
                                      {'name': 'joint3',
                                       'limits': [-2.8973, 2.8973],
                                       'urdf_limits': [-2.8973, 2.8973],
                                       'velocity': 2.175,
                                       'effort': 87.0,
                                       'mass': 3.228604,
                                       'origin': {'xyz': [0.0, -0.316, 0.0], 'rpy': [1.57079633, 0.0, 0.0]},
                                       'axis': [0.0, 0.0, 1.0]},
                                      {'name': 'joint4',
                                       'limits': [-3.0718, -0.0698],
                                       'urdf_limits': [-3.0718, -0.0698],
                                       'velocity': 2.175,
                                       'effort': 87.0,
                                       'mass': 3.587895,
                                       'origin': {'xyz': [0.0825, 0.0, 0.0], 'rpy': [1.57079633, 0.0, 0.0]},
                                       'axis': [0.0, 0.0, 1.0]},
                                      {'name': 'joint5',
                                       'limits': [-2.8973, 2.8973],
                                       'urdf_limits': [-2.8973, 2.8973],
                                       'velocity': 2.61,
                                       'effort': 12.0,
                                       'mass': 1.225946,
                                       'origin': {'xyz': [-0.0825, 0.384, 0.0], 'rpy': [-1.57079633, 0.0, 0.0]},
                                       'axis': [0.0, 0.0, 1.0]},
                                      {'name': 'joint6',
                                       'limits': [-0.0175, 3.7525],
                                       'urdf_limits': [-0.0175, 3.7525],
                                       'velocity': 2.61,
                                       'effort': 12.0,
                                       'mass': 1.666555,
                                       'origin': {'xyz': [0.0, 0.0, 0.0], 'rpy': [1.57079633, 0.0, 0.0]},
                                       'axis': [0.0, 0.0, 1.0]},
                                      {'name': 'joint7',
                                       'limits': [-2.8973, 2.8973],
                                       'urdf_limits': [-2.8973, 2.8973],
                                       'velocity': 2.61,
                                       'effort': 12.0,
                                       'mass': 0.735522,
                                       'origin': {'xyz': [0.088, -0.107, 0.0], 'rpy': [1.57079633, 0.0, 0.0]},
                                       'axis': [0.0, 0.0, 1.0]}]},
                   'end_effector': {'kind': 'parallel_gripper',
                                    'dim': 1,
                                    'stroke': 0.08,
                                    'finger_range': [0.0, 0.04],
                                    'finger_origin': [0.0, 0.0, 0.0584],
                                    'velocity': 0.2,
                                    'effort': 20.0,
                                    'tcp': {'xyz': [0.0, 0.0, 0.1034], 'rpy': [0.0, 0.0, -0.78539816]},
                                    'forward_axis': [0.0, 0.0, 1.0],
                                    'slide_axis': [-0.70710678, -0.70710678, 0.0]},
                   'mounts': {'left': {'xyz': [-0.3, -0.55, 0.765], 'quaternion': [0.7071068, 0.0, 0.0, 0.7071068]},
                              'right': {'xyz': [0.3, -0.55, 0.765],
                                        'quaternion': [0.7071068, 0.0, 0.0, 0.7071068]}},
                   'sources': ['google-deepmind/mujoco_menagerie franka_emika_panda at 1b428b08 (Apache-2.0): '
                               'joint frames, limits, torques, masses, finger travel, home',
                               'frankaemika/franka_ros franka_description (Apache-2.0): speeds, finger speed and '
                               'force, tcp'],
                   'caveats': ['The Panda (FER); the FR3 has other limits.',
                               "joint7's frame is slid 107 mm along its own axis to the flange, which changes no "
                               'motion.',
                               "The hand is turned by -45 degrees about the flange's z axis, and the tcp's frame "
                               'with it.',
                               "No maker's scene mounts two of these arms at a table: the mounts are this "
                               "standard's, farther from the table's middle than those of the smaller arms."]},
 'piper': {'name': 'piper',
           'aliases': [],
           'description': 'Two AgileX Piper arms of six joints with parallel grippers, side by side at a table.',
           'arms': ['left', 'right'],
           'arm': {'dof': 6,
                   'home': [0.0, 1.57, -1.3485, 0.0, 0.0, 0.0],
                   'base_mass': 1.02,
                   'joints': [{'name': 'joint1',
                               'limits': [-2.618, 2.618],
                               'urdf_limits': [-2.618, 2.618],
                               'velocity': 5.0,
                               'effort': 100.0,
                               'mass': 0.71,
                               'origin': {'xyz': [0.0, 0.0, 0.123], 'rpy': [0.0, 0.0, 0.0]},
                               'axis': [0.0, 0.0, 1.0]},
                              {'name': 'joint2',
                               'limits': [0.0, 3.14],
                               'urdf_limits': [0.0, 3.14],
                               'velocity': 5.0,
                               'effort': 100.0,
                               'mass': 1.16,
                               'origin': {'xyz': [0.0, 0.0, 0.0], 'rpy': [1.5708, -0.1359, -3.1416]},
                               'axis': [0.0, 0.0, 1.0]},
                              {'name': 'joint3',
                               'limits': [-2.967, 0.0],
                               'urdf_limits': [-2.967, 0.0],
                               'velocity': 5.0,
                               'effort': 100.0,
                               'mass': 0.5,
                               'origin': {'xyz': [0.28503, 0.0, 0.0], 'rpy': [0.0, 0.0, -1.7939]},
                               'axis': [0.0, 0.0, 1.0]},
                              {'name': 'joint4',
                               'limits': [-1.745, 1.745],
                               'urdf_limits': [-1.745, 1.745],
                               'velocity': 5.0,
                               'effort': 100.0,
                               'mass': 0.38,
                               'origin': {'xyz': [-0.021984, -0.25075, 0.0], 'rpy': [1.5708, 0.0, 0.0]},
                               'axis': [0.0, 0.0, 1.0]},
                              {'name': 'joint5',
                               'limits': [-1.22, 1.22],
                               'urdf_limits': [-1.22, 1.22],
                               'velocity': 5.0,
                               'effort': 100.0,
                               'mass': 0.383,
                               'origin': {'xyz': [0.0, 0.0, 0.0], 'rpy': [-1.5708, 0.0, 0.0]},
                               'axis': [0.0, 0.0, 1.0]},
                              {'name': 'joint6',
                               'limits': [-2.0944, 2.0944],
                               'urdf_limits': [-2.0944, 2.0944],
                               'velocity': 3.0,
                               'effort': 100.0,
                               'mass': 0.457,
                               'origin': {'xyz': [8.8259e-05, -0.091, 0.0], 'rpy': [1.5708, 0.0, 0.0]},
                               'axis': [0.0, 0.0, 1.0]}]},
           'end_effector': {'kind': 'parallel_gripper',
                            'dim': 1,
                            'stroke': 0.07,
                            'finger_range': [0.0, 0.035],
                            'finger_origin': [0.0, 0.0, 0.1358],
                            'velocity': 1.0,
                            'effort': 10.0,
                            'tcp': {'xyz': [0.0, 0.0, 0.1358], 'rpy': [0.0, 0.0, 0.0]},
                            'forward_axis': [0.0, 0.0, 1.0],
                            'slide_axis': [0.0, 1.0, 0.0]},
           'mounts': {'left': {'xyz': [-0.3, -0.45, 0.765], 'quaternion': [0.7071068, 0.0, 0.0, 0.7071068]},
                      'right': {'xyz': [0.3, -0.45, 0.765], 'quaternion': [0.7071068, 0.0, 0.0, 0.7071068]}},
           'sources': ['agilexrobotics/Piper_ros piper_description.urdf at 116596ce (MIT): joint frames, masses, '
                       'limits, gripper',
                       'google-deepmind/mujoco_menagerie agilex_piper (MIT): home',
                       'RoboTwin env_cfg/robot/dual_piper.yml: mounts'],
           'caveats': ["effort is the description's placeholder (100 N m for every joint).",
                       'home is a keyframe of the menagerie model, whose joint 3 has a slightly different zero and '
                       'range.',
                       "mass of joint6 is link6 with the gripper's base.",
                       'joint5 reaches 1.22 rad only: a gripper that points straight down is possible in a small '
                       'region.',
                       'Older descriptions differ: joint4 +-1.832, joint6 +-3.14, joint2 tilt -0.10095, joint3 '
                       '1.3826, fingers of 38 mm.',
                       'tcp is given as a point; its frame is parallel to the flange.']},
 'piper_single': {'name': 'piper_single',
                  'aliases': [],
                  'description': 'One AgileX Piper arm of six joints with a parallel gripper.',
                  'arms': ['single'],
                  'arm': {'dof': 6,
                          'home': [0.0, 1.57, -1.3485, 0.0, 0.0, 0.0],
                          'base_mass': 1.02,
                          'joints': [{'name': 'joint1',
                                      'limits': [-2.618, 2.618],
                                      'urdf_limits': [-2.618, 2.618],
                                      'velocity': 5.0,
                                      'effort': 100.0,
                                      'mass': 0.71,
                                      'origin': {'xyz': [0.0, 0.0, 0.123], 'rpy': [0.0, 0.0, 0.0]},
                                      'axis': [0.0, 0.0, 1.0]},
                                     {'name': 'joint2',
                                      'limits': [0.0, 3.14],
                                      'urdf_limits': [0.0, 3.14],
                                      'velocity': 5.0,
                                      'effort': 100.0,
                                      'mass': 1.16,
                                      'origin': {'xyz': [0.0, 0.0, 0.0], 'rpy': [1.5708, -0.1359, -3.1416]},
                                      'axis': [0.0, 0.0, 1.0]},
                                     {'name': 'joint3',
                                      'limits': [-2.967, 0.0],
                                      'urdf_limits': [-2.967, 0.0],
                                      'velocity': 5.0,
                                      'effort': 100.0,
                                      'mass': 0.5,
                                      'origin': {'xyz': [0.28503, 0.0, 0.0], 'rpy': [0.0, 0.0, -1.7939]},
                                      'axis': [0.0, 0.0, 1.0]},
                                     {'name': 'joint4',
                                      'limits': [-1.745, 1.745],
                                      'urdf_limits': [-1.745, 1.745],
                                      'velocity': 5.0,
                                      'effort': 100.0,
                                      'mass': 0.38,
                                      'origin': {'xyz': [-0.021984, -0.25075, 0.0], 'rpy': [1.5708, 0.0, 0.0]},
                                      'axis': [0.0, 0.0, 1.0]},
                                     {'name': 'joint5',
                                      'limits': [-1.22, 1.22],
                                      'urdf_limits': [-1.22, 1.22],
                                      'velocity': 5.0,
                                      'effort': 100.0,
                                      'mass': 0.383,
                                      'origin': {'xyz': [0.0, 0.0, 0.0], 'rpy': [-1.5708, 0.0, 0.0]},
                                      'axis': [0.0, 0.0, 1.0]},
                                     {'name': 'joint6',
                                      'limits': [-2.0944, 2.0944],
                                      'urdf_limits': [-2.0944, 2.0944],
                                      'velocity': 3.0,
                                      'effort': 100.0,
                                      'mass': 0.457,
                                      'origin': {'xyz': [8.8259e-05, -0.091, 0.0], 'rpy': [1.5708, 0.0, 0.0]},
                                      'axis': [0.0, 0.0, 1.0]}]},
                  'end_effector': {'kind': 'parallel_gripper',
                                   'dim': 1,
                                   'stroke': 0.07,
                                   'finger_range': [0.0, 0.035],
                                   'finger_origin': [0.0, 0.0, 0.1358],
                                   'velocity': 1.0,
                                   'effort': 10.0,
                                   'tcp': {'xyz': [0.0, 0.0, 0.1358], 'rpy': [0.0, 0.0, 0.0]},
                                   'forward_axis': [0.0, 0.0, 1.0],
                                   'slide_axis': [0.0, 1.0, 0.0]},
                  'mounts': {'left': {'xyz': [-0.3, -0.45, 0.765], 'quaternion': [0.7071068, 0.0, 0.0, 0.7071068]},
                             'right': {'xyz': [0.3, -0.45, 0.765], 'quaternion': [0.7071068, 0.0, 0.0, 0.7071068]}},
                  'sources': ['agilexrobotics/Piper_ros piper_description.urdf at 116596ce (MIT): joint frames, '
                              'masses, limits, gripper',
                              'google-deepmind/mujoco_menagerie agilex_piper (MIT): home',
                              'RoboTwin env_cfg/robot/dual_piper.yml: mounts'],
                  'caveats': ["effort is the description's placeholder (100 N m for every joint).",
                              'home is a keyframe of the menagerie model, whose joint 3 has a slightly different '
                              'zero and range.',
                              "mass of joint6 is link6 with the gripper's base.",
                              'joint5 reaches 1.22 rad only: a gripper that points straight down is possible in a '
                              'small region.',
                              'Older descriptions differ: joint4 +-1.832, joint6 +-3.14, joint2 tilt -0.10095, '
                              'joint3 1.3826, fingers of 38 mm.',
                              'tcp is given as a point; its frame is parallel to the flange.']},
 'piper_x': {'name': 'piper_x',
             'aliases': [],
             'description': 'Two AgileX Piper X arms of six joints with parallel grippers, side by side at a '
                            'table.',
             'arms': ['left', 'right'],
             'arm': {'dof': 6,
                     'home': None,
                     'base_mass': 1.07,
                     'joints': [{'name': 'joint1',
                                 'limits': [-2.618, 2.618],
                                 'urdf_limits': [-2.618, 2.618],
                                 'velocity': 10.0,
                                 'effort': 100.0,
                                 'mass': 0.71,
                                 'origin': {'xyz': [0.0, 0.0, 0.123], 'rpy': [0.0, 0.0, 0.0]},
                                 'axis': [0.0, 0.0, 1.0]},
                                {'name': 'joint2',
                                 'limits': [0.0, 3.14],
                                 'urdf_limits': [0.0, 3.14],
                                 'velocity': 10.0,
                                 'effort': 100.0,
                                 'mass': 1.16,
                                 'origin': {'xyz': [0.0, 0.0, 0.0], 'rpy': [1.5708, -0.13586, 3.1416]},
                                 'axis': [0.0, 0.0, 1.0]},
                                {'name': 'joint3',
                                 'limits': [-2.9671, 0.0],
                                 'urdf_limits': [-2.9671, 0.0],
                                 'velocity': 10.0,
                                 'effort': 100.0,
                                 'mass': 0.67,
                                 'origin': {'xyz': [0.28503, 0.0, 0.0], 'rpy': [0.0, 0.0, 2.8377]},
                                 'axis': [0.0, 0.0, 1.0]},
                                {'name': 'joint4',
                                 'limits': [-1.57, 1.57],
                                 'urdf_limits': [-1.57, 1.57],
                                 'velocity': 10.0,
                                 'effort': 100.0,
                                 'mass': 0.4,
                                 'origin': {'xyz': [0.27264, 0.0, 0.0], 'rpy': [0.0, 0.0, 0.075129]},
                                 'axis': [0.0, 0.0, 1.0]},
                                {'name': 'joint5',
                                 'limits': [-1.57, 1.57],
                                 'urdf_limits': [-1.57, 1.57],
                                 'velocity': 10.0,
                                 'effort': 100.0,
                                 'mass': 0.35,
                                 'origin': {'xyz': [0.076857, 0.00062395, 0.0], 'rpy': [-1.5708, 0.0, 0.0]},
                                 'axis': [0.0, 0.0, 1.0]},
                                {'name': 'joint6',
                                 'limits': [-3.14, 3.14],
                                 'urdf_limits': [-3.14, 3.14],
                                 'velocity': 10.0,
                                 'effort': 100.0,
                                 'mass': 0.527,
                                 'origin': {'xyz': [0.035, 0.0, 0.0], 'rpy': [1.5708, 0.0, 1.5708]},
                                 'axis': [0.0, 0.0, 1.0]}]},
             'end_effector': {'kind': 'parallel_gripper',
                              'dim': 1,
                              'stroke': 0.1,
                              'finger_range': [0.0, 0.05],
                              'finger_origin': [0.0, 0.0, 0.13503],
                              'velocity': 1.0,
                              'effort': 10.0,
                              'tcp': {'xyz': [0.0, 0.0, 0.13503], 'rpy': [0.0, 0.0, 0.0]},
                              'forward_axis': [0.0, 0.0, 1.0],
                              'slide_axis': [0.0, 1.0, 0.0]},
             'mounts': {'left': {'xyz': [-0.3, -0.35, 0.765], 'quaternion': [0.7071068, 0.0, 0.0, 0.7071068]},
                        'right': {'xyz': [0.3, -0.35, 0.765], 'quaternion': [0.7071068, 0.0, 0.0, 0.7071068]}},
             'sources': ['agilexrobotics/Piper_ros piper_x_description.urdf at 116596ce (MIT): joint frames, '
                         'masses, limits, gripper',
                         'RoboTwin env_cfg/robot/dual_piper_x.yml: mounts'],
             'caveats': ["effort is the description's placeholder (100 N m for every joint).",
                         'No home pose is published.',
                         'tcp is given as a point; its frame is parallel to the flange.']},
 'piper_x_single': {'name': 'piper_x_single',
                    'aliases': [],
                    'description': 'One AgileX Piper X arm of six joints with a parallel gripper.',
                    'arms': ['single'],
                    'arm': {'dof': 6,
                            'home': None,
                            'base_mass': 1.07,
                            'joints': [{'name': 'joint1',
                                        'limits': [-2.618, 2.618],
                                        'urdf_limits': [-2.618, 2.618],
                                        'velocity': 10.0,
                                        'effort': 100.0,
                                        'mass': 0.71,
                                        'origin': {'xyz': [0.0, 0.0, 0.123], 'rpy': [0.0, 0.0, 0.0]},
                                        'axis': [0.0, 0.0, 1.0]},
                                       {'name': 'joint2',
                                        'limits': [0.0, 3.14],
                                        'urdf_limits': [0.0, 3.14],
                                        'velocity': 10.0,
                                        'effort': 100.0,
                                        'mass': 1.16,
                                        'origin': {'xyz': [0.0, 0.0, 0.0], 'rpy': [1.5708, -0.13586, 3.1416]},
                                        'axis': [0.0, 0.0, 1.0]},
                                       {'name': 'joint3',
                                        'limits': [-2.9671, 0.0],
                                        'urdf_limits': [-2.9671, 0.0],
                                        'velocity': 10.0,
                                        'effort': 100.0,
                                        'mass': 0.67,
                                        'origin': {'xyz': [0.28503, 0.0, 0.0], 'rpy': [0.0, 0.0, 2.8377]},
                                        'axis': [0.0, 0.0, 1.0]},
                                       {'name': 'joint4',
                                        'limits': [-1.57, 1.57],
                                        'urdf_limits': [-1.57, 1.57],
                                        'velocity': 10.0,
                                        'effort': 100.0,
                                        'mass': 0.4,
                                        'origin': {'xyz': [0.27264, 0.0, 0.0], 'rpy': [0.0, 0.0, 0.075129]},
                                        'axis': [0.0, 0.0, 1.0]},
                                       {'name': 'joint5',
                                        'limits': [-1.57, 1.57],
                                        'urdf_limits': [-1.57, 1.57],
                                        'velocity': 10.0,
                                        'effort': 100.0,
                                        'mass': 0.35,
                                        'origin': {'xyz': [0.076857, 0.00062395, 0.0], 'rpy': [-1.5708, 0.0, 0.0]},
                                        'axis': [0.0, 0.0, 1.0]},
                                       {'name': 'joint6',
                                        'limits': [-3.14, 3.14],
                                        'urdf_limits': [-3.14, 3.14],
                                        'velocity': 10.0,
                                        'effort': 100.0,
                                        'mass': 0.527,
                                        'origin': {'xyz': [0.035, 0.0, 0.0], 'rpy': [1.5708, 0.0, 1.5708]},
                                        'axis': [0.0, 0.0, 1.0]}]},
                    'end_effector': {'kind': 'parallel_gripper',
                                     'dim': 1,
                                     'stroke': 0.1,
                                     'finger_range': [0.0, 0.05],
                                     'finger_origin': [0.0, 0.0, 0.13503],
                                     'velocity': 1.0,
                                     'effort': 10.0,
                                     'tcp': {'xyz': [0.0, 0.0, 0.13503], 'rpy': [0.0, 0.0, 0.0]},
                                     'forward_axis': [0.0, 0.0, 1.0],
                                     'slide_axis': [0.0, 1.0, 0.0]},
                    'mounts': {'left': {'xyz': [-0.3, -0.35, 0.765],
                                        'quaternion': [0.7071068, 0.0, 0.0, 0.7071068]},
                               'right': {'xyz': [0.3, -0.35, 0.765],
                                         'quaternion': [0.7071068, 0.0, 0.0, 0.7071068]}},
                    'sources': ['agilexrobotics/Piper_ros piper_x_description.urdf at 116596ce (MIT): joint '
                                'frames, masses, limits, gripper',
                                'RoboTwin env_cfg/robot/dual_piper_x.yml: mounts'],
                    'caveats': ["effort is the description's placeholder (100 N m for every joint).",
                                'No home pose is published.',
                                'tcp is given as a point; its frame is parallel to the flange.']},
 'tianji_marvin_wuji': {'name': 'tianji_marvin_wuji',
                        'aliases': [],
                        'description': 'Two Tianji Marvin arms of seven joints with Wuji hands of twenty joints, '
                                       'whose state is in radians.',
                        'arms': ['left', 'right'],
                        'arm': {'dof': 7, 'home': None, 'base_mass': None, 'joints': None},
                        'end_effector': {'kind': 'hand',
                                         'dim': 20,
                                         'stroke': None,
                                         'finger_range': None,
                                         'finger_origin': None,
                                         'velocity': None,
                                         'effort': None,
                                         'tcp': None,
                                         'forward_axis': None,
                                         'slide_axis': None},
                        'mounts': None,
                        'sources': ['the embodiment registry of the field: dimensions'],
                        'caveats': ['Dimensions only: joint names, limits and frames are not recorded yet.']}}

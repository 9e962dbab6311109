"""ROS 2 launch file: `roomtables serve` beside a running Hydra.

Not run by this project, which has no ROS 2: it follows the launch API's documentation, and
`roomtables serve` itself is tested over ZMQ without ROS. Copy it and change the arguments.

    ros2 launch ./roomtables.launch.py labelspace:=/path/to/ade20k_mp3d_label_space.yaml
"""

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, ExecuteProcess, OpaqueFunction
from launch.substitutions import LaunchConfiguration

ARGUMENTS = {
    "command": ("roomtables", "The program; a path where it is in an environment of its own"),
    "tables": ("tables", "The tables folder that `roomtables build` wrote"),
    "labels": ("", "The label space of the tables; by default household"),
    "labelspace": ("", "The path of Hydra's label-space YAML, where the graphs name no labels"),
    "offline": ("false", "true: never ask a language model"),
    "recv": ("tcp://127.0.0.1:8001", "Where Hydra's ZmqSink publishes"),
    "send": ("tcp://127.0.0.1:8002", "Where Hydra's ZmqRoomLabelUpdater listens"),
}


def serve(context: LaunchContext) -> list[ExecuteProcess]:
    """The service, with each argument that has a value as an option."""
    values = {name: LaunchConfiguration(name).perform(context) for name in ARGUMENTS}
    command = [values.pop("command"), "serve"]
    command += ["--offline"] * (values.pop("offline") == "true")
    command += [part for name, value in values.items() if value for part in (f"--{name}", value)]
    return [ExecuteProcess(cmd=command, output="screen", respawn=True, respawn_delay=2.0)]


def generate_launch_description() -> LaunchDescription:
    """Declare the arguments above, and start the service with them."""
    declared = [
        DeclareLaunchArgument(name, default_value=default, description=description)
        for name, (default, description) in ARGUMENTS.items()
    ]
    return LaunchDescription([*declared, OpaqueFunction(function=serve)])

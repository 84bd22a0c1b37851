"""A bag as ROS 2 would write it, by rosbags."""

from __future__ import annotations

import numpy as np

from lmkit.io.ros_camera_info import rig_to_camera_infos


def write_bag(
    folder,
    rig,
    pairs=3,
    encoding="rgb8",
    late=0.0,
    rate=(0.0, 0.0, 0.3),
    gravity=(0.0, 0.0, 0.0),
    cameras=("left", "right"),
):
    """Stereo images of one color each, camera_info, odometry along x, and a gyro."""
    import yaml
    from rosbags.rosbag2 import Writer
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    make = store.types

    def header(time):
        return make["std_msgs/msg/Header"](
            make["builtin_interfaces/msg/Time"](int(time), round(time % 1 * 1e9)), "side"
        )

    with Writer(folder, version=8) as writer:

        def say(topic, kind, time, message):
            if topic not in said:
                said[topic] = writer.add_connection(topic, kind, typestore=store)
            writer.write(said[topic], round(time * 1e9), store.serialize_cdr(message, kind))

        said = {}
        width, height = rig.left.image_size
        for k in range(pairs):
            for side, text in zip(cameras, rig_to_camera_infos(rig), strict=True):
                time = 100.0 + k / 4 + (late if side == cameras[1] else 0.002 * (side == cameras[1]))
                color = np.full((height, width, 3), (10 + k, 100, 200), np.uint8)
                image = make["sensor_msgs/msg/Image"](
                    header(time), height, width, encoding, 0, 3 * width, color.ravel()
                )
                say(f"/cam/{side}/image_raw", "sensor_msgs/msg/Image", time, image)
                info = yaml.safe_load(text)
                roi = make["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)
                arrays = [
                    np.array(info[name]["data"], dtype=np.float64)
                    for name in (
                        "distortion_coefficients", "camera_matrix", "rectification_matrix", "projection_matrix"
                    )
                ]  # fmt: skip
                message = make["sensor_msgs/msg/CameraInfo"](
                    header(time), height, width, info["distortion_model"], *arrays, 0, 0, roi
                )
                say(f"/cam/{side}/camera_info", "sensor_msgs/msg/CameraInfo", time, message)
        vector, zero = make["geometry_msgs/msg/Vector3"], make["geometry_msgs/msg/Vector3"](0.0, 0.0, 0.0)
        quaternion = make["geometry_msgs/msg/Quaternion"](0.0, 0.0, np.sin(0.1), np.cos(0.1))
        for k in range(10):
            time = 100.0 + k / 10
            pose = make["geometry_msgs/msg/Pose"](make["geometry_msgs/msg/Point"](0.1 * k, 0.0, 0.0), quaternion)
            odometry = make["nav_msgs/msg/Odometry"](
                header(time),
                "base",
                make["geometry_msgs/msg/PoseWithCovariance"](pose, np.zeros(36)),
                make["geometry_msgs/msg/TwistWithCovariance"](
                    make["geometry_msgs/msg/Twist"](zero, zero), np.zeros(36)
                ),
            )
            say("/odom", "nav_msgs/msg/Odometry", time, odometry)
            imu = make["sensor_msgs/msg/Imu"](
                header(time), quaternion, np.zeros(9), vector(*rate), np.zeros(9), vector(*gravity), np.zeros(9)
            )
            say("/imu", "sensor_msgs/msg/Imu", time, imu)

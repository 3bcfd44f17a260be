"""The shape of a ROS 2 node: subscribers, publishers and timers around the control loop.

`ros` stands for rclpy: `publisher`, `subscribe`, `timer` and `now` replace create_publisher(…)
.publish, create_subscription, create_timer and get_clock().now(). `stamp` of a message replaces
header.stamp; `stamp` and `now` are in seconds. Run it: python examples/ros2_shape.py
"""

from functools import partial
from types import SimpleNamespace as Message
from typing import Any

import numpy as np

from app import ControlLoop, Measurement, RobotModel, load_robot
from app.simulation.plants import make_physics


class AvoidanceNode:
    """Reads /joint_states and /odom, writes /arm/effort at 1 kHz and /cmd_vel at 10 Hz."""

    def __init__(self, loop: ControlLoop, ros: Any) -> None:
        self.loop, self.joints, self.odom, self.now = loop, None, None, ros.now
        self.send_effort, self.send_velocity = map(ros.publisher, ("/arm/effort", "/cmd_vel"))
        ros.subscribe("/joint_states", partial(setattr, self, "joints"))
        ros.subscribe("/odom", partial(setattr, self, "odom"))
        ros.timer(0.001, self.control)
        ros.timer(0.1, self.drive)

    def control(self) -> None:
        """Execute a control step if each of the two topics has had a message."""
        if (arm := self.joints) and (base := self.odom):
            readings = base.pose, base.velocity, arm.position, arm.velocity
            measured = Measurement(*readings, (), self.now(), arm.stamp, base.stamp)
            self.send_effort(Message(effort=self.loop.step(measured).u_a))

    def drive(self) -> None:
        """Send the present velocity command of the base."""
        self.send_velocity(Message(velocity=self.loop.controller.last.v_cmd))


def main(steps: int = 300) -> dict[str, Any]:
    """Run the node with a simulated robot, without ROS; returns each topic's last message."""
    model, sent, callbacks, timers = RobotModel(load_robot("husky_panda")), {}, {}, {}
    robot, time = make_physics("kinematic", model), [0.0]
    ros = Message(subscribe=callbacks.__setitem__, timer=timers.__setitem__, now=lambda: time[0])
    ros.publisher = lambda topic: partial(sent.__setitem__, topic)
    AvoidanceNode(ControlLoop(model), ros)
    for k in range(steps):
        now, time[0] = robot.measure(), 0.001 * k
        callbacks["/joint_states"](Message(position=now.q_m, velocity=now.qd_m, stamp=time[0]))
        base = {"pose": now.base_pose, "velocity": now.base_velocity}
        callbacks["/odom"](Message(**base, stamp=time[0]))
        for callback in (timers[s] for s in timers if k % round(1000 * s) == 0):
            callback()
        robot.step(sent["/arm/effort"].effort, sent["/cmd_vel"].velocity, np.zeros(3))
    return sent


if __name__ == "__main__":
    print(main())

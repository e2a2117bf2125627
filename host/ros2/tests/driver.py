"""Publisher of velocities, which a test kills."""

import rclpy
from geometry_msgs.msg import TwistStamped

rclpy.init()
node = rclpy.create_node("driver")
publisher = node.create_publisher(TwistStamped, "cmd_vel", 10)


def publish():
    # A stamp of 0 counts as now.
    message = TwistStamped()
    message.twist.linear.x = 0.3
    publisher.publish(message)


node.create_timer(0.02, publish)
rclpy.spin(node)

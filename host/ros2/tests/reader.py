"""Reliable reader of odometry, which a test kills."""

import rclpy
from nav_msgs.msg import Odometry

rclpy.init()
node = rclpy.create_node("reader")
seen = []
node.create_subscription(Odometry, "odom", lambda message: seen or (seen.append(message), print("seen", flush=True)), 10)
rclpy.spin(node)

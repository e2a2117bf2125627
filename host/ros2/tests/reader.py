"""A reliable reader of odometry that does nothing else, to be killed."""

import rclpy
from nav_msgs.msg import Odometry

rclpy.init()
node = rclpy.create_node("reader")
seen = []
node.create_subscription(Odometry, "odom", lambda message: seen or (seen.append(message), print("seen", flush=True)), 10)
rclpy.spin(node)

"""Oracle for the tests of r4-systems: a hexagonal shell is driven against two boxes in MuJoCo.

Writes whisker_mujoco.json beside itself. Needs: pip install mujoco==3.17.0

The shell is rigid, with a prescribed angle, and moves along x only, driven by a velocity servo of limited force (the traction). Boxes are free
bodies on a plane under gravity; 36 small feet spread each one's weight over its base, so that its friction against turning is that of the
whole base. Shell and boxes touch with a friction of 0.3, feet and floor with that of the case. Friction, contact and the boxes' tilt are
MuJoCo's own (elliptic cones). No code is shared with r4-world.
"""

import json
import math
import pathlib
import platform

import mujoco
import numpy as np

S, SPEED, STEP = 0.21, 0.187, 0.0005


def run(mass, friction, alpha, seconds=5.0, traction=12.0):
    w, nose = S * math.sin(alpha), S / 2 + S * math.cos(alpha)
    corners = [(nose, 0), (S / 2, w), (-S / 2, w), (-nose, 0), (-S / 2, -w), (S / 2, -w)]
    vertices = " ".join(f"{x} {y} {z}" for x, y in corners for z in (-0.01, 0.01))
    feet = "".join(f'<geom class="foot" pos="{(i + .5) / 6 * .165 - .0825} {(j + .5) / 6 * .22 - .11} -0.0525"/>'
                   for i in range(6) for j in range(6))
    inertia = f"{mass * (.22**2 + .115**2) / 12} {mass * (.165**2 + .115**2) / 12} {mass * (.165**2 + .22**2) / 12}"
    boxes = "".join(f"""
    <body name="{name}" pos="0.4925 {y} 0.0575"><freejoint/>
      <inertial pos="0 0 0" mass="{mass}" diaginertia="{inertia}"/>
      <geom name="{name}" type="box" size="0.0825 0.11 0.05"/>{feet}
    </body>""" for name, y in (("left", 0.23), ("right", -0.23)))
    contact = "".join(f'<pair geom1="shell" geom2="{n}" condim="3" friction="0.3 0.3 0.005 0.0001 0.0001"/>' for n in ("left", "right"))
    model = mujoco.MjModel.from_xml_string(f"""
<mujoco>
  <option timestep="{STEP}" integrator="implicitfast" cone="elliptic" impratio="10" iterations="100"/>
  <default>
    <geom contype="0" conaffinity="0"/>
    <default class="foot"><geom type="sphere" size="0.005" mass="0" contype="1" conaffinity="0" friction="{friction} 0 0"/></default>
  </default>
  <asset><mesh name="hexagon" vertex="{vertices}"/></asset>
  <worldbody>
    <geom type="plane" size="5 5 0.1" contype="0" conaffinity="1" friction="{friction} 0 0" priority="1" condim="3"/>
    <body name="robot" pos="0 0 0.03"><joint name="x" type="slide" axis="1 0 0"/>
      <inertial pos="0 0 0" mass="2.5" diaginertia="0.03 0.03 0.03"/>
      <geom name="shell" type="mesh" mesh="hexagon"/>
    </body>{boxes}
  </worldbody>
  <contact>{contact}</contact>
  <actuator><velocity joint="x" kv="2000" forcerange="-{traction} {traction}"/></actuator>
</mujoco>""")
    data = mujoco.MjData(model)
    rows = []
    for number in range(round(seconds / STEP)):
        data.ctrl[0] = min(SPEED, number * STEP)
        mujoco.mj_step(model, data)
        if (number + 1) % round(0.5 / STEP) == 0:
            def pose(name):
                body = data.body(name)
                yaw = 2 * math.atan2(body.xquat[3], body.xquat[0])
                return [float(body.xpos[0]), float(body.xpos[1]), yaw]
            rows.append([(number + 1) * STEP, float(data.qpos[0]), *pose("left"), *pose("right")])
    return dict(mass_kg=mass, friction=friction, panels_rad=alpha, rows=[[round(v, 6) for v in row] for row in rows])


def main():
    wide, narrow = math.pi / 3, 0.58
    cases = [run(10.2, 0.4, wide), run(10.2, 0.4, narrow), run(0.16, 0.4, wide), run(0.26, 0.4, wide), run(0.26, 0.4, 0.8)]
    result = dict(versions=dict(mujoco=mujoco.__version__, numpy=np.__version__, python=platform.python_version()), cases=cases)
    pathlib.Path(__file__).with_name("whisker_mujoco.json").write_text(json.dumps(result, separators=(",", ":")) + "\n")
    for case in cases:
        print(case["mass_kg"], case["panels_rad"], *case["rows"][-1])


main()

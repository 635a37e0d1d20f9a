"""Poses for tools/linuxcnc-check: make them, drive LinuxCNC through them, compare the joints."""

import csv
import math
import random
import sys


def poses(path):
    draw = random.Random(50)
    with open(path, "w") as out:
        out.write("x_mm,y_mm,z_mm,b_deg,c_deg\n")
        for _ in range(50):
            place = [draw.uniform(-150, 150) for _ in range(3)]
            turn = [draw.uniform(-110, 110), draw.uniform(-360, 360)]
            out.write(",".join(f"{v:.6f}" for v in place + turn) + "\n")


def drive(poses_path, joints_path):
    import time

    import linuxcnc

    command, status = linuxcnc.command(), linuxcnc.stat()

    def until(what, done):
        for _ in range(3000):
            status.poll()
            if done():
                return
            time.sleep(0.01)
        sys.exit(f"LinuxCNC never got to: {what}")

    until("an answer", lambda: True)
    command.state(linuxcnc.STATE_ESTOP_RESET)
    command.wait_complete()
    command.state(linuxcnc.STATE_ON)
    until("machine on", lambda: status.task_state == linuxcnc.STATE_ON)
    command.mode(linuxcnc.MODE_MANUAL)
    command.wait_complete()
    command.teleop_enable(0)
    command.wait_complete()
    command.home(-1)
    until("homed", lambda: all(status.homed[:9]))
    command.mode(linuxcnc.MODE_MDI)
    command.wait_complete()
    with open(poses_path) as source, open(joints_path, "w") as out:
        out.write("jx_mm,jy_mm,jz_mm,b_deg,c_deg\n")
        for row in csv.DictReader(source):
            words = " ".join(f"{n[0].upper()}{v}" for n, v in row.items())
            command.mdi(f"G0 {words}")
            command.wait_complete(30)
            until("the pose", lambda: status.inpos and status.interp_state == linuxcnc.INTERP_IDLE)
            # "In position" comes while the last ten-thousandths are still being made.
            joint = None
            while joint != status.joint_position:
                joint = status.joint_position
                time.sleep(0.05)
                status.poll()
            out.write(",".join(f"{joint[i]:.9f}" for i in (0, 1, 2, 4, 5)) + "\n")


def compare(expected_path, joints_path, delta_x):
    with open(expected_path) as e, open(joints_path) as j:
        pairs = list(zip(csv.DictReader(e), csv.DictReader(j)))
    worst = 0.0
    for expected, joints in pairs:
        for name, shift in (("jx_mm", delta_x), ("jy_mm", 0.0), ("jz_mm", 0.0)):
            # Joint 0 of maxkins reads X - X_C - delta_x (see the exported ini file).
            worst = max(worst, abs(float(expected[name]) - shift - float(joints[name])))
    verdict = "pass" if len(pairs) == 50 and worst <= 1e-4 and math.isfinite(worst) else "fail"
    print(f"{len(pairs)} poses, largest difference of a joint {worst:.2e} mm: {verdict}")
    sys.exit(verdict != "pass")


if __name__ == "__main__":
    task, *rest = sys.argv[1:]
    if task == "poses":
        poses(rest[0])
    elif task == "drive":
        drive(rest[0], rest[1])
    else:
        compare(rest[0], rest[1], float(rest[2]))

"""Pinocchio's forward kinematics of a five-joint chain: nanoseconds a call, the cost of the call from
Python (a model without joints) taken off. No errors, positions of all joints only."""

import time

import numpy as np
import pinocchio as pin


def chain(joints):
    model = pin.Model()
    parent = 0
    for joint in joints:
        place = pin.SE3(np.eye(3), np.array([40.0, -30.0, 20.0]))
        parent = model.addJoint(parent, joint, place, f"j{parent}")
    return model


def best_ns(model, calls=200_000):
    data = model.createData()
    q = np.full(model.nq, 0.3)
    times = []
    for _ in range(5):
        start = time.perf_counter()
        for _ in range(calls):
            pin.forwardKinematics(model, data, q)
        times.append(time.perf_counter() - start)
    return min(times) / calls * 1e9


def main():
    five = [pin.JointModelRZ(), pin.JointModelRX(), pin.JointModelPX(), pin.JointModelPY(), pin.JointModelPZ()]
    with_call = best_ns(chain(five))
    call = best_ns(chain([]))
    print(f"pinocchio_with_call {with_call:.1f}")
    print(f"pinocchio_call {call:.1f}")
    print(f"pinocchio {with_call - call:.1f}")


main()

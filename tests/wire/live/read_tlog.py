"""Reads a telemetry log as pymavlink's tools do. Prints a JSON object: messages by type, and how long the log is, s."""
import collections
import json
import os
import sys

os.environ["MAVLINK20"] = "1"
os.environ["MAVLINK_DIALECT"] = "ardupilotmega"
from pymavlink import mavutil

log = mavutil.mavlink_connection(sys.argv[1])
counts, times = collections.Counter(), []
while True:
    message = log.recv_msg()
    if message is None:
        break
    counts[message.get_type()] += 1
    times.append(message._timestamp)
print(json.dumps({"counts": counts, "seconds": times[-1] - times[0], "rising": times == sorted(times)}))

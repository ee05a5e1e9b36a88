"""pymavlink's own signing, in a file of MAVLink bytes.

sign.py sign KEY LINK STAMP < unsigned > signed     signs every frame of system 1 as it comes
sign.py check KEY STAMP < bytes                     prints how many frames are good, and how many are not
"""
import os
import sys

os.environ["MAVLINK20"] = "1"
os.environ["MAVLINK_DIALECT"] = "ardupilotmega"
from pymavlink.dialects.v20 import ardupilotmega as mavlink

what, key, *numbers = sys.argv[1:]
numbers = [int(n) for n in numbers]
mav = mavlink.MAVLink(None, srcSystem=1, srcComponent=1)
mav.signing.secret_key = bytes.fromhex(key)
mav.robust_parsing = True
data = sys.stdin.buffer.read()
if what == "sign":
    mav.signing.link_id, mav.signing.timestamp = numbers
    mav.signing.sign_outgoing = True
    plain = mavlink.MAVLink(None)
    for message in plain.parse_buffer(data) or []:
        sys.stdout.buffer.write(message.pack(mav))
        mav.seq = (mav.seq + 1) % 256
else:
    (mav.signing.timestamp,) = numbers
    good, bad = 0, 0
    for message in mav.parse_buffer(data) or []:
        if message.get_type() == "BAD_DATA" or not message.get_signed():
            bad += 1
        else:
            good += 1
    print(good, bad)

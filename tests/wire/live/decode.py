"""Prints what pymavlink reads in a file of MAVLink bytes, one JSON object a line."""
import json
import os
import sys

os.environ["MAVLINK20"] = "1"
os.environ["MAVLINK_DIALECT"] = "ardupilotmega"
from pymavlink.dialects.v20 import ardupilotmega as mavlink

parser = mavlink.MAVLink(None)
parser.robust_parsing = False
with open(sys.argv[1], "rb") as source:
    for message in parser.parse_buffer(source.read()) or []:
        fields = message.to_dict()
        fields["system"] = message.get_srcSystem()
        fields["component"] = message.get_srcComponent()
        fields["sequence"] = message.get_seq()
        print(json.dumps(fields))

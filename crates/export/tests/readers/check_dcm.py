"""dcmReader on a DCM file, compared with the JSON of the same package; any log record is a failure."""
import json
import logging
import sys

import dcmReader.dcm_reader as module
from dcmReader.dcm_reader import DcmReader


class Count(logging.Handler):
    records = []

    def emit(self, record):
        Count.records.append(record.getMessage())


logging.getLogger().handlers = [Count()]
module.logger.handlers = [Count()]
module.logger.propagate = False
reader = DcmReader()
reader.read(sys.argv[1])
assert not Count.records, Count.records
want = {c["name"]: c for c in json.load(open(sys.argv[2]))["package"]["characteristics"]}
seen = 0
for p in reader.get_parameters():
    assert p.value == want[p.name]["values"][0], p.name
    seen += 1
for b in reader.get_block_parameters():
    values = list(b.values) if not isinstance(b.values[0], (list, tuple)) else [x for r in b.values for x in r]
    assert values == want[b.name]["values"], (b.name, b.values)
    seen += 1
for c in list(reader.get_characteristic_lines()) + list(reader.get_group_characteristic_lines()):
    axis = want[c.name]["axes"][0]
    assert list(c.values.keys()) == axis["points"] and list(c.values.values()) == want[c.name]["values"], c.name
    assert c.unit_x == axis["unit"] and c.unit_values == want[c.name]["unit"]
    seen += 1
for c in list(reader.get_characteristic_maps()) + list(reader.get_group_characteristic_maps()):
    x, y = want[c.name]["axes"]
    table = [c.values[b][a] for b in y["points"] for a in x["points"]]
    assert table == want[c.name]["values"], (c.name, c.values)
    if x["shared"]:
        assert (c.x_mapping, c.y_mapping) == (x["name"], y["name"]), (c.x_mapping, c.y_mapping)
    seen += 1
assert seen == len(want), (seen, len(want))
assert len(reader.get_distributions()) == len({a["name"] for c in want.values() for a in c["axes"] if a["shared"]})
print(f"dcmReader: {seen} characteristics, no log record")

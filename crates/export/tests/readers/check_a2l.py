"""pya2ldb's parser and validator on an A2L file."""
import json
import sys

import pya2l.model as model
from pya2l import DB
from pya2l.api.inspect import Characteristic
from pya2l.api.validate import Validator

session = DB().import_a2l(sys.argv[1], in_memory=True)
want = {c["name"]: c for c in json.load(open(sys.argv[2]))["package"]["characteristics"]}
kinds = {0: ("VALUE", "VAL_BLK"), 1: ("CURVE",), 2: ("MAP",)}
for name, c in want.items():
    symbol = name if len(c["axes"]) or len(c["values"]) == 1 else f"{name}_table"
    found = Characteristic.get(session, symbol)
    assert found.type in kinds[len(c["axes"])], (name, found.type)
    assert [a.maxAxisPoints for a in found.axisDescriptions] == [len(a["points"]) for a in c["axes"]], name
validator = Validator(session)
validator()
assert not validator.diagnostics, validator.diagnostics
print(f"pya2ldb: {len(want)} characteristics, no diagnostics")

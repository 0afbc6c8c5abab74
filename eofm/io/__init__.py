"""Files: images, fields as TIFF, tables as CSV, summaries as JSON.

The only room that knows file formats:

- `images`: what a file holds, checked: an image or volume, a stack, a pair, a field; and writing
  them.
- `tables`: CSV, YAML and JSON.
- `scan`: an array, the meaning of its axes, and the size of its pixels.
- `formats`: the array of a file of any format; `tiff`, `plain`, `matlab` and others each know one.
- `stored`: arrays larger than the memory, of which windows are read and written.
- `apart`: the process of their own in which libraries read what may crash them.
- `vti`: fields for ParaView.
- `limits`: how large an array may be, how long a foreign reader may take.
- `places`: where files are written, each complete or not at all, and several as one.
- `origin`: what a result comes from, and checksums of what was written.
"""

from eofm.io.images import (
    read_field,
    read_image,
    read_pair,
    read_scan,
    read_scans,
    read_stack,
    write_field,
    write_image,
    write_pages,
)
from eofm.io.limits import limit_size
from eofm.io.origin import Origin, checksum, mark, reading
from eofm.io.places import check_place, remove, replacing, together
from eofm.io.scan import PixelSize, Scan, pixel_size
from eofm.io.stored import Store, Stored, new_store, open_store, open_stored, scratch_store, windows
from eofm.io.tables import (
    BUBBLE_COLUMNS,
    read_bubbles,
    read_columns,
    read_settings,
    write_json,
    write_table,
)
from eofm.io.tiff import write_slices
from eofm.io.vti import write_vti, write_vti_slices

__all__ = [
    "BUBBLE_COLUMNS",
    "Origin",
    "PixelSize",
    "Scan",
    "Store",
    "Stored",
    "check_place",
    "checksum",
    "limit_size",
    "mark",
    "new_store",
    "open_store",
    "open_stored",
    "pixel_size",
    "read_bubbles",
    "read_columns",
    "read_field",
    "read_image",
    "read_pair",
    "read_scan",
    "read_scans",
    "read_settings",
    "read_stack",
    "reading",
    "remove",
    "replacing",
    "scratch_store",
    "together",
    "windows",
    "write_field",
    "write_image",
    "write_json",
    "write_pages",
    "write_slices",
    "write_table",
    "write_vti",
    "write_vti_slices",
]

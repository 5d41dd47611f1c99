"""Writer of VTP files."""

import zlib
from collections.abc import Mapping
from xml.sax.saxutils import quoteattr

import numpy as np

from ostiform.errors import InputError
from ostiform.surface.raw_mesh import Array, RawMesh

_TYPES = {
    "i1": "Int8", "u1": "UInt8", "i2": "Int16", "u2": "UInt16", "i4": "Int32", "u4": "UInt32",
    "i8": "Int64", "u8": "UInt64", "f4": "Float32", "f8": "Float64",
}  # fmt: skip


def vtp_bytes(mesh: RawMesh, field_data: Mapping[str, Array | str] | None = None) -> bytes:
    """Return a mesh as the bytes of a VTP file: appended raw data, compressed by zlib.

    Parameters
    ----------
    mesh : RawMesh
    field_data : mapping of str to array or str, optional
        Facts about the whole mesh: numbers, or a text.

    Raises
    ------
    InputError
        If an array holds neither numbers nor booleans.
    """
    appended = bytearray()

    def listed(name: str, values: Array, is_field: bool = False) -> str:
        plain = values.astype(np.uint8) if values.dtype == np.bool_ else values
        kind = _TYPES.get(plain.dtype.str[1:])
        if kind is None:
            raise InputError(f"expected numbers in the array {name}, found {values.dtype}")
        width = int(np.prod(values.shape[1:], dtype=np.int64))
        count = f'NumberOfTuples="{len(values)}" ' if is_field else ""
        offset = len(appended)
        appended.extend(_block(plain.astype(plain.dtype.newbyteorder("<")).tobytes()))
        return (
            f'<DataArray type="{kind}" Name={quoteattr(name)} NumberOfComponents="{width}" '
            f'{count}format="appended" offset="{offset}"/>\n'
        )

    offsets = np.arange(3, 3 * len(mesh.faces) + 1, 3)
    facts = {**({"SPACE": mesh.space} if mesh.space else {}), **(field_data or {})}
    fields = "".join(
        _text(name, value) if isinstance(value, str) else listed(name, value, is_field=True)
        for name, value in facts.items()
    )
    stated = f"<FieldData>\n{fields}</FieldData>\n" if fields else ""
    text = (
        '<?xml version="1.0"?>\n'
        '<VTKFile type="PolyData" version="1.0" byte_order="LittleEndian" header_type="UInt64" '
        'compressor="vtkZLibDataCompressor">\n<PolyData>\n'
        f'{stated}<Piece NumberOfPoints="{len(mesh.vertices)}" NumberOfVerts="0" '
        f'NumberOfLines="0" NumberOfStrips="0" NumberOfPolys="{len(mesh.faces)}">\n'
        f"<PointData>\n{''.join(listed(n, v) for n, v in mesh.point_data.items())}</PointData>\n"
        f"<CellData>\n{''.join(listed(n, v) for n, v in mesh.cell_data.items())}</CellData>\n"
        f"<Points>\n{listed('Points', mesh.vertices)}</Points>\n"
        f"<Polys>\n{listed('connectivity', mesh.faces.reshape(-1))}"
        f"{listed('offsets', offsets)}</Polys>\n"
        '</Piece>\n</PolyData>\n<AppendedData encoding="raw">\n_'
    )
    return text.encode("utf-8") + bytes(appended) + b"\n</AppendedData>\n</VTKFile>\n"


def _text(name: str, text: str) -> str:
    codes = " ".join(str(code) for code in f"{text}\0".encode())
    return (
        f'<Array type="String" Name={quoteattr(name)} NumberOfTuples="1" format="ascii">'
        f"{codes}</Array>\n"
    )


def _block(plain: bytes) -> bytes:
    """Return one compressed block with its header: count, size, size of a partial one, length."""
    packed = zlib.compress(plain, 6)
    return np.array([1, len(plain), 0, len(packed)], dtype="<u8").tobytes() + packed

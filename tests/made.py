"""Files of formats that labs have, made for the tests."""

import gzip
import zipfile
import zlib

import zarr
from pydicom.dataset import FileDataset, FileMetaDataset
from pydicom.uid import ExplicitVRLittleEndian, RLELossless, SecondaryCaptureImageStorage


def write_mha(path, V, spacing="", packed=False, more=""):
    """By hand; SimpleITK writes the same."""
    data = zlib.compress(V.tobytes()) if packed else V.tobytes()
    name = {"f4": "FLOAT", "u1": "UCHAR", "i2": "SHORT"}[V.dtype.str[1:]]
    sizes = " ".join(map(str, V.shape[::-1]))
    text = f"ObjectType = Image\nNDims = {V.ndim}\nBinaryData = True\n{more}"
    text += f"BinaryDataByteOrderMSB = {V.dtype.str[0] == '>'}\nCompressedData = {packed}\n"
    text += f"ElementSpacing = {spacing}\n" * bool(spacing) + f"DimSize = {sizes}\n"
    path.write_bytes(f"{text}ElementType = MET_{name}\nElementDataFile = LOCAL\n".encode() + data)


def write_nrrd(path, V, packed=False, more="", kind="float", encoding=None):
    data = gzip.compress(V.tobytes()) if packed else V.tobytes()
    sizes = " ".join(map(str, V.shape[::-1]))
    text = f"NRRD0004\n# made here\ntype: {kind}\ndimension: {V.ndim}\nsizes: {sizes}\n{more}"
    text += f"encoding: {encoding or ('gzip' if packed else 'raw')}\nendian: little\nkey:=a: b\n\n"
    path.write_bytes(text.encode() + data)


def write_oct(path, listed, slash="\\", packed=zipfile.ZIP_DEFLATED, header=None):
    """A file like Thorlabs': arrays by name, (slices, depth, lateral), and a table in XML."""
    text, members = "", {}
    for name, (A, kind) in listed.items():
        slices, depth, lateral = A.shape
        place = f"data{slash}{name}.data"
        ranges = f'RangeZ="{depth * 4e-3}" RangeX="{lateral * 2.5e-3}" RangeY="{slices * 12e-3}"'
        text += (
            f'<DataFile Type="{kind}" SizeZ="{depth}" SizeX="{lateral}" SizeY="{slices}" {ranges}'
            f' BytesPerPixel="{A.dtype.itemsize}">{place}</DataFile>\n'
        )
        members[place] = A.transpose(0, 2, 1).tobytes()
    text = f'<?xml version="1.0"?>\n<Ocity version="1.0"><DataFiles>{text}</DataFiles></Ocity>'
    with zipfile.ZipFile(path, "w", packed) as archive:
        archive.writestr("Header.xml", header or text)
        for place, data in members.items():
            archive.writestr(place, data)


def write_dicom(path, A, syntax=ExplicitVRLittleEndian, **more):
    """A greyscale image or frames of 16 bits."""
    meta = FileMetaDataset()
    meta.MediaStorageSOPClassUID = SecondaryCaptureImageStorage
    meta.MediaStorageSOPInstanceUID = "1.2.3"
    meta.TransferSyntaxUID = ExplicitVRLittleEndian
    file = FileDataset(path, {}, file_meta=meta, preamble=b"\0" * 128)
    file.SOPClassUID, file.SOPInstanceUID = SecondaryCaptureImageStorage, "1.2.3"
    file.Rows, file.Columns = A.shape[-2:]
    if A.ndim == 3:
        file.NumberOfFrames = len(A)
    file.SamplesPerPixel, file.PhotometricInterpretation = 1, "MONOCHROME2"
    file.BitsAllocated = file.BitsStored = 16
    file.HighBit, file.PixelRepresentation = 15, 0
    file.PixelData = A.astype("<u2").tobytes()
    for name, value in more.items():
        setattr(file, name, value)
    if syntax == RLELossless:
        file.compress(RLELossless)
    file.save_as(path, enforce_file_format=True)


def write_zarr(path, V, version, unit="micrometer", axes="zyx", scale=(12.0, 4.0, 2.5)):
    """An OME-Zarr with two levels, whose sizes are in the finest's scale and the image's."""
    root = zarr.open_group(path, mode="w", zarr_format=version)
    for name, values in (("0", V), ("1", V[..., ::2, ::2])):
        root.create_array(name, data=values, chunks=tuple(max(n // 2, 1) for n in values.shape))
    scale = [*[1.0] * (V.ndim - 3), *scale]
    half = [{"type": "scale", "scale": [s / 2 for s in scale]}]
    both = [{"type": "scale", "scale": [2.0] * V.ndim}]
    named = [{"name": a, "type": "space", "unit": unit} for a in axes]
    levels = [{"path": name, "coordinateTransformations": half} for name in "01"]
    image = {"axes": named, "datasets": levels, "coordinateTransformations": both}
    said = {"multiscales": [image]}
    root.attrs.update(said if version == 2 else {"ome": said | {"version": "0.5"}})

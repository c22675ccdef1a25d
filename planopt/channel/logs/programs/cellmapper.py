"""CellMapper: CSV of the serving cell."""

from planopt.channel.logs.readers import LogReader

CELLMAPPER = LogReader(
    summary="CellMapper (Android), CSV of the serving cell",
    signature=("latitude", "longitude", "altitude", "MCC", "MNC", "LAC", "CID", "signal"),
    x="longitude",
    y="latitude",
    power="signal",
    transmitter="CID",
    no_power=("0",),
)

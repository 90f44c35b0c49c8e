"""A control loop for the rig's own computer: as a C header, or as an ONNX graph."""

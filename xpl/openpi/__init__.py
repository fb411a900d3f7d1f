"""openpi's wire, both ways: its messages (`codec`), the mapping of its names (`names`), and both together (`wire`).

Source: Physical-Intelligence/openpi, packages/openpi-client (websocket_client_policy.py, msgpack_numpy.py) and
src/openpi/serving/websocket_policy_server.py. A server sends its metadata first, then answers each observation with a
map that holds `actions`, or with an error as text. There are no identifiers and there is no reset.
"""

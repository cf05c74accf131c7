"""Hypothesis strategies for messages with any values that the wire can carry."""

from hypothesis import strategies as st

from beamtouch_protocol.messages import Hello, Identify, Ping, Pong, Reading, Start

u8 = st.integers(0, 2**8 - 1)
u16 = st.integers(0, 2**16 - 1)
u32 = st.integers(0, 2**32 - 1)
counts = st.lists(st.just(0) | u16, min_size=1, max_size=32).map(tuple)

st.register_type_strategy(Start, st.builds(Start, rate_hz=u16, oversampling=u8))
st.register_type_strategy(Ping, st.builds(Ping, token=u16))
st.register_type_strategy(Pong, st.builds(Pong, token=u16, device_us=u32))
st.register_type_strategy(Identify, st.builds(Identify, seconds=u8))
st.register_type_strategy(Reading, st.builds(Reading, sequence=u16, device_us=u32, oversampling=u8, counts=counts))
st.register_type_strategy(
    Hello,
    st.builds(Hello, protocol_version=u8, schema_hash=u32, boot_id=u32, channel_count=u8, adc_bits=u8, max_rate_hz=u16),
)

"""The virtual flight test: what pilot, day and sensors do, and logs of it with known truth.

`plan_flight` plans a flight, `narxcal.turbofan` simulates its engines, `sensors.record` measures
them, and `fly.write_flights` writes the logs of a `FlightScenario`.
"""

"""The service: takes samples, answers `GET /contact`, keeps a record of contacts."""

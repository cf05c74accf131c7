"""The contact service: samples in, `GET /contact` out."""

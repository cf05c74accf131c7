"""Samples to the service: the log, its two readers, the client.

acquisition -> boots -> log                        samples that the record lacks, boot by boot, in memory
log_store -> boots, log_file                       those that wait for long go to a file
live -> boots (live_window), sending               new samples as they come
backlog -> boots, log_store, sending               what the record lacks, in order
sending -> client, boots (pace)                    one request, and what its answer says of boot and line
readiness -> client                                whether the service takes the samples of a surface
"""

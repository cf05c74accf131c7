-- As written by the service of format 1.
CREATE TABLE events (
    id INTEGER PRIMARY KEY AUTOINCREMENT, surface TEXT NOT NULL, model TEXT NOT NULL, boot_id TEXT NOT NULL,
    first_sequence INTEGER NOT NULL, last_sequence INTEGER NOT NULL, touched_us INTEGER NOT NULL,
    last_us INTEGER NOT NULL, lifted_us INTEGER, "begin" TEXT NOT NULL, "end" TEXT NOT NULL, samples INTEGER NOT NULL,
    position_sum_mm REAL NOT NULL, peak_force_n REAL, peak_position_mm REAL, degraded INTEGER NOT NULL,
    path TEXT NOT NULL, recorded_s REAL NOT NULL);
CREATE INDEX by_time ON events (touched_us, id);
CREATE INDEX by_surface ON events (surface, touched_us, id);
CREATE INDEX by_first ON events (surface, boot_id, first_sequence);
CREATE INDEX by_last ON events (surface, boot_id, last_sequence);
CREATE INDEX by_record ON events (recorded_s);
INSERT INTO events VALUES
    (7, 'press-7', 'tiny@000000', 'boot-0001', 0, 9, 0, 45000, 50000, 'touch', 'lift', 10, 1000.0, NULL, NULL, 0,
     '[[0, 99.5, 5.25], [5, 98.0, null]]', 0.0),
    (8, 'press-7', 'tiny@000000', 'boot-0001', 10, 12, 50000, 60000, NULL, 'unseen', 'open', 3, 300.0, NULL, NULL, 0,
     '[]', 0.0);
PRAGMA user_version = 1;

-- format 17
CREATE TABLE beamtouch_format (
    format INTEGER NOT NULL
);
CREATE INDEX by_boot ON events (surface, boot_id);
CREATE INDEX by_record ON events (recorded_s);
CREATE INDEX by_subject ON trail (action, surface, subject, number);
CREATE INDEX by_surface ON events (surface, touched_us, id);
CREATE INDEX by_time ON events (touched_us, id);
CREATE TABLE commissionings (
    id INTEGER NOT NULL PRIMARY KEY AUTOINCREMENT,
    surface VARCHAR NOT NULL,
    run VARCHAR NOT NULL,
    report JSON NOT NULL,
    UNIQUE (run)
);
CREATE TABLE cursors (
    surface VARCHAR NOT NULL,
    boot_id VARCHAR NOT NULL,
    durable BIGINT NOT NULL,
    version BIGINT NOT NULL,
    model VARCHAR NOT NULL,
    memory JSON NOT NULL,
    event BIGINT,
    recorded_s DOUBLE NOT NULL,
    PRIMARY KEY (surface, boot_id)
);
CREATE TABLE deliveries (
    number INTEGER NOT NULL PRIMARY KEY AUTOINCREMENT,
    destination VARCHAR NOT NULL,
    event BIGINT NOT NULL,
    FOREIGN KEY(event) REFERENCES events (id) ON DELETE CASCADE
);
CREATE TABLE destinations (
    name VARCHAR NOT NULL,
    PRIMARY KEY (name)
);
CREATE TABLE events (
    id INTEGER NOT NULL PRIMARY KEY AUTOINCREMENT,
    surface VARCHAR NOT NULL,
    model VARCHAR NOT NULL,
    boot_id VARCHAR NOT NULL,
    first_sequence BIGINT NOT NULL,
    last_sequence BIGINT NOT NULL,
    touched_us BIGINT NOT NULL,
    last_us BIGINT NOT NULL,
    kind VARCHAR(20) NOT NULL,
    "begin" VARCHAR(20) NOT NULL,
    "end" VARCHAR(20) NOT NULL,
    lifted_us BIGINT,
    samples BIGINT NOT NULL,
    unsteady_samples BIGINT NOT NULL,
    place JSON NOT NULL,
    mean_force_n DOUBLE,
    mean_force_low_n DOUBLE,
    mean_force_high_n DOUBLE,
    peak_force_n DOUBLE,
    peak_force_low_n DOUBLE,
    peak_force_high_n DOUBLE,
    unexplained_us BIGINT NOT NULL,
    ends_unexplained BOOLEAN NOT NULL,
    degraded BOOLEAN NOT NULL,
    unsteady BOOLEAN NOT NULL,
    path JSON NOT NULL,
    best JSON,
    zones JSON NOT NULL,
    capture JSON NOT NULL,
    recorded_s DOUBLE NOT NULL
);
CREATE TABLE health (
    surface VARCHAR NOT NULL,
    version BIGINT NOT NULL,
    model VARCHAR NOT NULL,
    characteristic VARCHAR,
    newest_us BIGINT NOT NULL,
    PRIMARY KEY (surface)
);
CREATE TABLE health_blocks (
    surface VARCHAR NOT NULL,
    first_us BIGINT NOT NULL,
    number INTEGER NOT NULL,
    block JSON NOT NULL,
    PRIMARY KEY (surface, first_us, number)
);
CREATE INDEX ix_commissionings_surface ON commissionings (surface);
CREATE INDEX ix_deliveries_event ON deliveries (event);
CREATE TABLE sqlite_sequence(name,seq);
CREATE TABLE time (
    passed_s DOUBLE NOT NULL,
    clock_s DOUBLE,
    deleted_old BIGINT NOT NULL,
    deleted_oversize BIGINT NOT NULL,
    told_s DOUBLE
);
CREATE TABLE trail (
    number INTEGER NOT NULL,
    at_us BIGINT NOT NULL,
    action VARCHAR(20) NOT NULL,
    details VARCHAR NOT NULL,
    surface VARCHAR NOT NULL,
    subject VARCHAR NOT NULL,
    "by" VARCHAR NOT NULL,
    token VARCHAR NOT NULL,
    address VARCHAR NOT NULL,
    digest VARCHAR NOT NULL,
    PRIMARY KEY (number)
);

-- Written by the service of format 4, and dumped as a kill would leave it.
BEGIN TRANSACTION;
CREATE TABLE baselines (
	surface VARCHAR NOT NULL, 
	model VARCHAR NOT NULL, 
	characteristic VARCHAR, 
	last_event BIGINT NOT NULL, 
	newest_us BIGINT NOT NULL, 
	history JSON NOT NULL, 
	PRIMARY KEY (surface)
);
CREATE TABLE captures (
	surface VARCHAR NOT NULL, 
	boot_id VARCHAR NOT NULL, 
	model VARCHAR NOT NULL, 
	sequence BIGINT NOT NULL, 
	sample JSON NOT NULL, 
	PRIMARY KEY (surface, boot_id, model, sequence)
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
	lifted_us BIGINT, 
	"begin" VARCHAR(20) NOT NULL, 
	"end" VARCHAR(20) NOT NULL, 
	samples BIGINT NOT NULL, 
	position_sum_mm DOUBLE NOT NULL, 
	peak_force_n DOUBLE, 
	peak_position_mm DOUBLE, 
	degraded BOOLEAN NOT NULL, 
	path JSON NOT NULL, 
	recorded_s DOUBLE NOT NULL, 
	kind VARCHAR(20) DEFAULT 'contact' NOT NULL, 
	unexplained_us BIGINT DEFAULT '0' NOT NULL, 
	ends_unexplained BOOLEAN DEFAULT '0' NOT NULL, 
	unsteady BOOLEAN DEFAULT '0' NOT NULL, 
	best JSON
);
INSERT INTO "events" VALUES(1,'press-7','tiny@000000','boot-0001',0,9,1784000000000000,1784000000045000,1784000000050000,'touch','lift',10,1000.0,NULL,NULL,0,'[[0,100.0,5.0]]',1784000000.0,'contact',0,0,0,NULL);
INSERT INTO "events" VALUES(2,'press-7','tiny@000000','boot-0001',20,24,1784000000100000,1784000000120000,NULL,'unseen','open',5,500.0,NULL,NULL,0,'[[0,100.0,5.0]]',1784000001.0,'contact',0,0,0,NULL);
CREATE INDEX by_open ON events (surface) WHERE "end" = 'open';
CREATE INDEX by_last ON events (surface, boot_id, last_sequence);
CREATE INDEX by_surface ON events (surface, touched_us, id);
CREATE INDEX by_time ON events (touched_us, id);
CREATE INDEX by_first ON events (surface, boot_id, first_sequence);
CREATE INDEX by_record ON events (recorded_s);
DELETE FROM "sqlite_sequence";
INSERT INTO "sqlite_sequence" VALUES('events',2);
COMMIT;
PRAGMA user_version = 4;

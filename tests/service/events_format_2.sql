-- Written by the service before format 3, and dumped after a kill.
BEGIN TRANSACTION;
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
	recorded_s DOUBLE NOT NULL
);
INSERT INTO "events" VALUES(1,'press-7','press-7@4ae9b8','boot-0001',2,4,1795218046128456,1795218046138456,1795218046143456,'touch','lift',3,500.0,12.5,200.0,0,'[[1795218046128456, 150.0, 8.75], [1795218046133456, 200.0, 12.5], [1795218046138456, 150.0, 8.75]]',1.79533277239902019505e+09);
INSERT INTO "events" VALUES(2,'press-7','press-7@4ae9b8','boot-0001',6,7,1795218046148456,1795218046153456,NULL,'touch','open',2,300.0,8.75,150.0,0,'[[1795218046148456, 150.0, 8.75], [1795218046153456, 150.0, 8.75]]',1.79533277381695437428e+09);
CREATE INDEX by_first ON events (surface, boot_id, first_sequence);
CREATE INDEX by_time ON events (touched_us, id);
CREATE INDEX by_open ON events (surface) WHERE "end" = 'open';
CREATE INDEX by_last ON events (surface, boot_id, last_sequence);
CREATE INDEX by_record ON events (recorded_s);
CREATE INDEX by_surface ON events (surface, touched_us, id);
DELETE FROM "sqlite_sequence";
INSERT INTO "sqlite_sequence" VALUES('events',2);
COMMIT;
PRAGMA user_version = 2;

// The words of the page in German: a line for each English sentence. `{}` stands for a figure or a name; where German
// has them in another order, `{1}` is the first of the English sentence.

/** What the page says itself. */
export const PAGE = {
  // the state
  "Contact": "Kontakt",
  "Clear": "Frei",
  "Unexplained": "Ungeklärt",
  "Connecting": "Verbindung wird aufgebaut",
  "No connection since {}": "Keine Verbindung seit {}",
  "Trying again.": "Neuer Versuch läuft.",
  "A reading token is needed": "Lese-Token erforderlich",
  "The service gives its data only to those who have one. Ask whoever runs the service.":
    "Der Dienst gibt seine Daten nur mit einem Token heraus. Fragen Sie den Betreiber des Dienstes.",
  "No news from the service": "Keine Nachricht vom Dienst",
  "None for {} s.": "Seit {} s keine.",
  "Stale: {}": "Veraltet: {}",
  "This page is older than the service": "Diese Seite ist älter als der Dienst",
  "This page has failed": "Fehler in dieser Seite",
  "Load it again.": "Laden Sie sie neu.",
  "There is no surface “{}”": "Es gibt keine Oberfläche „{}“",
  "There is {}.": "Vorhanden: {}.",
  "The service has no surface": "Der Dienst hat keine Oberfläche",
  "Start it with --model MODEL or --config FILE.": "Starten Sie ihn mit --model MODEL oder --config FILE.",
  "The service answers, but its stream does not arrive. A proxy may hold it back.":
    "Der Dienst antwortet, aber sein Datenstrom kommt nicht an. Vielleicht hält ein Proxy ihn zurück.",
  "A proxy answers with a page of its own, perhaps a login: load this page again.":
    "Ein Proxy antwortet mit einer eigenen Seite, vielleicht einer Anmeldung: Laden Sie diese Seite neu.",
  "A proxy asks for a login ({}): load this page again.":
    "Ein Proxy verlangt eine Anmeldung ({}): Laden Sie diese Seite neu.",
  "A proxy does not reach the service ({}).": "Ein Proxy erreicht den Dienst nicht ({}).",
  "A proxy answers in place of the service ({}).": "Ein Proxy antwortet anstelle des Dienstes ({}).",

  // notes on a contact
  "Something acts on the beam that is not a single contact, or a sensor is wrong":
    "Auf den Balken wirkt etwas, das kein einzelner Kontakt ist, oder ein Sensor misst falsch",
  "Something acts on the plate that is not a single contact, or a sensor is wrong":
    "Auf die Platte wirkt etwas, das kein einzelner Kontakt ist, oder ein Sensor misst falsch",
  "Look whether more than one thing touches the beam, whether something is wedged under it, and at the sensors":
    "Prüfen Sie die Sensoren, und ob mehr als ein Gegenstand den Balken berührt oder etwas darunter klemmt",
  "Look whether more than one thing touches the plate, whether something is wedged under it, and at the sensors":
    "Prüfen Sie die Sensoren, und ob mehr als ein Gegenstand die Platte berührt oder etwas darunter klemmt",
  "The device does not keep its rate": "Das Gerät hält seine Abtastrate nicht ein",
  "The sender states another noise than the model was made for":
    "Der Sender gibt ein anderes Rauschen an, als dem Modell zugrunde liegt",
  "Too few sensors to tell a single contact from anything else":
    "Zu wenige Sensoren, um einen einzelnen Kontakt von anderem zu unterscheiden",
  "A sensor has been out for too long: it needs repair":
    "Ein Sensor ist schon zu lange ausgefallen: Er muss instand gesetzt werden",
  "Two daemons send samples of this surface: stop one of them":
    "Zwei Daemons senden Messwerte dieser Oberfläche: Halten Sie einen davon an",
  "Zeros have moved, as in warmth: wait until it settles, take everything off, then tare":
    "Die Nullpunkte sind gewandert, wie bei Erwärmung: Warten Sie, bis sie ruhig bleiben, räumen Sie alles ab und tarieren Sie dann",
  "The force is beyond the range of the scene": "Die Kraft liegt außerhalb des vorgesehenen Bereichs",
  "The beam moves, or one sample does not settle the state":
    "Der Balken bewegt sich, oder ein einzelner Messwert lässt den Zustand offen",
  "The plate moves, or one sample does not settle the state":
    "Die Platte bewegt sich, oder ein einzelner Messwert lässt den Zustand offen",
  "{}: the interval is wide": "{}: Das Intervall ist breit",
  "Degraded: without {}": "Eingeschränkt: ohne {}",
  "Sensor {} contradicts the others: check it first":
    "Sensor {} widerspricht den anderen: Prüfen Sie ihn zuerst",

  // figures, charts and drawings
  "Position": "Position",
  "Force": "Kraft",
  "Age": "Alter",
  "x": "x",
  "y": "y",
  "not estimated": "nicht bestimmt",
  "at most {} ms": "höchstens {} ms",
  "Misfit {}, over the limit of {}": "Restfehler {}, über der Grenze von {}",
  "Misfit {}, the limit is {}": "Restfehler {}, die Grenze ist {}",
  "{} in {}, last minute": "{} in {}, letzte Minute",
  "now": "jetzt",
  "Model {}": "Modell {}",
  " at {} mm": " bei {} mm",
  "check {}": "{} prüfen",
  "The beam is drawn once the service says what it looks like.":
    "Der Balken wird gezeichnet, sobald der Dienst sagt, wie er aussieht.",
  "Position and deflection are not known.": "Position und Durchbiegung sind nicht bekannt.",
  "Circles: measured deflection, {} times larger.": "Kreise: gemessene Durchbiegung, {}-fach vergrößert.",
  "Circles: measured deflection, in {}, to a scale of their own.":
    "Kreise: gemessene Durchbiegung in {}, in eigenem Maßstab.",
  "The shape between them is not known.": "Die Form dazwischen ist nicht bekannt.",
  "Line: the beam by the model.": "Linie: der Balken laut Modell.",
  "Line: a smooth curve through them.": "Linie: eine glatte Kurve durch die Kreise.",
  "Hatched: 95 % interval.": "Schraffiert: 95-%-Intervall.",
  "The plate is drawn once the service says what it looks like.":
    "Die Platte wird gezeichnet, sobald der Dienst sagt, wie sie aussieht.",
  "The plate from above, to scale.": "Die Platte von oben, maßstäblich.",
  "Rings: supports that give way.": "Ringe: nachgiebige Auflager.",
  "Hatched: where 95 % of such contacts are.": "Schraffiert: Hier liegen 95 % solcher Kontakte.",
  "Hatched: the 95 % intervals of x and y.": "Schraffiert: die 95-%-Intervalle von x und y.",

  // sensors, zones, events, alarms
  "good": "gut",
  "out of range": "außer Bereich",
  "saturated": "übersteuert",
  "stuck": "hängt",
  "missing": "fehlt",
  "not known": "unbekannt",
  "check first": "zuerst prüfen",
  "inside": "innen",
  "outside": "außen",
  "unsure": "unsicher",
  "Began at": "Beginn",
  "Mean at": "Mittlere Position",
  "Mean force": "Mittlere Kraft",
  "For": "Dauer",
  "unexplained": "ungeklärt",
  "to": "bis",
  ", at most {}": ", höchstens {}",
  ", {} in {}": ", {} in {}",
  ", {} unexplained": ", {} ungeklärt",
  ", unsteady": ", unruhig",
  "still": "dauert an",
  "and {} more": "und {} weitere",
  "since": "seit",
  "seen since": "gesehen seit",
  "Wiring: {}.": "Verdrahtung: {}.",
  ", or ": " oder ",
  "{} has lost {} % since {}.": "{1} hat seit dem {3} {2} % Empfindlichkeit verloren.",
  "{} has gained {} % since {}.": "{1} hat seit dem {3} {2} % Empfindlichkeit gewonnen.",
  "{} reads {} too little at rest since {}.": "{1} zeigt in Ruhe seit dem {3} {2} zu wenig.",
  "{} reads {} too much at rest since {}.": "{1} zeigt in Ruhe seit dem {3} {2} zu viel.",

  "The candidate for the model is not compared: {}.": "Der Kandidat für das Modell wird nicht verglichen: {}.",
  "Candidate {} for the model: another state in {} of {} samples.":
    "Kandidat {} für das Modell: anderer Zustand bei {} von {} Messwerten.",
  "Contacts differ by {}.": "Kontakte weichen um {} ab.",
  "It is worse.": "Er ist schlechter.",
  "Nothing speaks against it.": "Nichts spricht gegen ihn.",
  "These are too few to judge it.": "Das sind zu wenige für ein Urteil.",

  // the token
  "This token is not accepted": "Dieses Token wird nicht angenommen",
  "The token kept here is not accepted any more": "Das hier gespeicherte Token wird nicht mehr angenommen",

  // commissioning
  "Press above each sensor, then at marks, while the page watches every channel. It takes some three minutes.":
    "Drücken Sie über jedem Sensor, dann an den Marken; die Seite beobachtet dabei jeden Kanal. Das dauert etwa drei Minuten.",
  "Tare the sensors first, and take everything off.": "Räumen Sie vorher alles ab und tarieren Sie die Sensoren.",
  "No commissioning is under way.": "Es läuft keine Inbetriebnahme.",
  "The service was restarted, or somebody ended this commissioning. Begin again.":
    "Der Dienst wurde neu gestartet, oder jemand hat diese Inbetriebnahme beendet. Beginnen Sie von vorn.",
  "The service does not answer. Trying again.": "Der Dienst antwortet nicht. Neuer Versuch läuft.",
  "This service keeps its record in memory only: download the result before it stops.":
    "Dieser Dienst hält sein Protokoll nur im Speicher: Laden Sie das Ergebnis herunter, bevor er beendet wird.",
  "Type your name.": "Geben Sie Ihren Namen ein.",
  "Type the write token of the service.": "Geben Sie das Schreib-Token des Dienstes ein.",
  "The result is on record as number {}.": "Das Ergebnis steht als Nummer {} im Protokoll.",
  "On record: {}": "Im Protokoll: {}",
  "passed": "bestanden",
  "not passed": "nicht bestanden",
  "{}, {}, by {}. {}": "{}, {}, von {}. {}",
  "mark at {} mm": "Marke bei {} mm",

  // what stands in the document
  "Beamtouch": "Beamtouch",
  "Surface": "Oberfläche",
  "Forget token": "Token löschen",
  "Now": "Jetzt",
  "Reading token": "Lese-Token",
  "Keep on this device until I forget it": "Auf diesem Gerät speichern, bis ich es lösche",
  "Show the page": "Seite anzeigen",
  "Commissioning": "Inbetriebnahme",
  "How long the press has been held": "Wie lange der Druck schon gehalten wird",
  "Write token": "Schreib-Token",
  "Begin": "Beginnen",
  "Your name": "Ihr Name",
  "Put on record": "Ins Protokoll aufnehmen",
  "Not seen: go on": "Nicht erkannt: weiter",
  "Abandon": "Abbrechen",
  "Close": "Schließen",
  "Download as text": "Als Text herunterladen (englisch)",
  "Download as JSON": "Als JSON herunterladen",
  "Zones": "Zonen",
  "Needs attention": "Handlungsbedarf",
  "Sensors": "Sensoren",
  "Name": "Name",
  "At, mm": "Position, mm",
  "Deflection,": "Durchbiegung,",
  "mm": "mm",
  "Quality": "Qualität",
  "Recent events": "Letzte Ereignisse",
  "Language": "Sprache",
  "Times in": "Zeiten in",
  "the zone of this device": "der Zeitzone dieses Geräts",
  "How to read this page": "So lesen Sie diese Seite",
  "The large figures are the newest contact; below each stands its 95 % interval. The hatched bar under the beam is the interval of the position. Where there is no fresh answer the figures are “—”: an old position is never shown.":
    "Die großen Zahlen beschreiben den neuesten Kontakt; unter jeder steht ihr 95-%-Intervall. Der schraffierte Streifen unter dem Balken ist das Intervall der Position. Ohne aktuelle Antwort steht „—“: Eine alte Position wird nie gezeigt.",
  "The beam is drawn as it bends under the contact, by the model; the circles are what the sensors measure. Circles beside the line mean that the contact does not explain everything. The misfit is the same as a number: how badly rest or one contact explains the sample. Over its limit, neither does.":
    "Der Balken ist so gezeichnet, wie er sich laut Modell unter dem Kontakt biegt; die Kreise zeigen, was die Sensoren messen. Kreise neben der Linie bedeuten, dass der Kontakt nicht alles erklärt. Der Restfehler ist dasselbe als Zahl: wie schlecht Ruhe oder ein einzelner Kontakt den Messwert erklärt. Über seiner Grenze erklärt ihn keines von beiden.",
  "A plate is drawn from above. Its contact is a cross, and the hatched region holds the place in 95 of 100 cases.":
    "Eine Platte ist von oben gezeichnet. Ihr Kontakt ist ein Kreuz, und das schraffierte Gebiet enthält den Ort in 95 von 100 Fällen.",
  "A zone is a part of the beam or the plate that the configuration names. A contact is “inside” once all of its interval has been in the zone for long enough, “outside” if none of it is, and otherwise “unsure”.":
    "Eine Zone ist ein Teil des Balkens oder der Platte, den die Konfiguration benennt. Ein Kontakt ist „innen“, sobald sein ganzes Intervall lange genug in der Zone war, „außen“, wenn nichts davon darin liegt, und sonst „unsicher“.",
  "“Unexplained” means that neither a beam at rest nor one contact explains what the sensors measure. Then there is no position and no force. Find the cause: a second contact, something wedged under the beam, a sensor that is loose or has drifted.":
    "„Ungeklärt“ heißt: Weder Ruhe noch ein einzelner Kontakt erklärt, was die Sensoren messen. Dann gibt es weder Position noch Kraft. Suchen Sie die Ursache: einen zweiten Kontakt, etwas Eingeklemmtes unter dem Balken, einen losen oder gedrifteten Sensor.",
  "The charts show the interval as a band. Hatched stretches are times without an answer; crossed ones, unexplained times; empty ones, times without a contact.":
    "Die Kurven zeigen das Intervall als Band. Schraffierte Strecken sind Zeiten ohne Antwort, kreuzweise schraffierte sind ungeklärte Zeiten, leere sind Zeiten ohne Kontakt.",
  "For technicians:": "Für Techniker:",
  "Commission this surface": "Diese Oberfläche in Betrieb nehmen",
  "For programs:": "Für Programme:",
  "the contact": "der Kontakt",
  "and": "und",
  "all addresses": "alle Adressen",
  ".": ".",
  "They take the token in the header": "Sie erwarten das Token im Header",
  "Authorization: Bearer TOKEN": "Authorization: Bearer TOKEN",
};

/** What the service says, a line for each sentence. A list of names stands in one `{}`, one of WORDS in `{word}`. */
export const SERVICE = {
  // titles of problems
  "The service has no surface": "Der Dienst hat keine Oberfläche",
  "The surface has no model": "Die Oberfläche hat kein Modell",
  "The surface has no samples yet": "Die Oberfläche hat noch keine Messwerte",
  "The model is of another beam than the samples": "Das Modell gehört zu einem anderen Balken als die Messwerte",
  "The newest sample is too old": "Der neueste Messwert ist zu alt",
  "Too few working channels": "Zu wenige funktionierende Kanäle",
  "The model gave no usable answer": "Das Modell lieferte keine brauchbare Antwort",
  "Sensors have failed": "Sensoren sind ausgefallen",
  "Sensors of the surface have changed": "Sensoren der Oberfläche haben sich verändert",
  "The zeros of the surface have moved": "Die Nullpunkte der Oberfläche sind gewandert",
  "The surface has been unexplained for too long": "Die Oberfläche ist schon zu lange ungeklärt",
  "A valid bearer token is required": "Ein gültiges Token ist nötig",
  "The token is for another purpose": "Das Token ist für einen anderen Zweck bestimmt",
  "There is no such surface": "Diese Oberfläche gibt es nicht",
  "There is no such commissioning": "Diese Inbetriebnahme gibt es nicht",
  "The commissioning is at another step": "Die Inbetriebnahme ist bei einem anderen Schritt",
  "The record of events is unavailable": "Das Ereignisprotokoll ist nicht erreichbar",
  "The service is stopping": "Der Dienst wird gerade beendet",
  "Too many clients at once": "Zu viele gleichzeitige Verbindungen",
  "The service failed": "Fehler im Dienst",

  // their causes, and what to do
  "Samples are accepted, but there is no model.": "Messwerte werden angenommen, aber es gibt kein Modell.",
  "Give one with --model or in the config.": "Geben Sie eines mit --model oder in der Konfiguration an.",
  "Samples are accepted, but its model file cannot be used.":
    "Messwerte werden angenommen, aber die Modelldatei ist nicht verwendbar.",
  "Samples are accepted, but its model file cannot be used. {}":
    "Messwerte werden angenommen, aber die Modelldatei ist nicht verwendbar. {}",
  "No sample has arrived since the service started.": "Seit dem Start des Dienstes kam kein Messwert an.",
  "Start the daemon, or check its log.": "Starten Sie den Daemon oder prüfen Sie sein Log.",
  "The samples are of beam {}, the model is of beam {}.":
    "Die Messwerte stammen vom Balken {}, das Modell gehört zum Balken {}.",
  "The samples are of structure {}, the model is of {} {}.":
    "Die Messwerte stammen von der Struktur {1}, das Modell gehört zur Struktur {3}.",
  "Give the service the model of {}, or the daemon the configuration that was built with this model ({}).":
    "Geben Sie dem Dienst das Modell von {} oder dem Daemon die Konfiguration, die zu diesem Modell gehört ({}).",
  "The newest sample is {} ms old; the limit is {} ms.": "Der neueste Messwert ist {} ms alt; die Grenze ist {} ms.",
  "Check that the daemon runs and reaches the device.": "Prüfen Sie, ob der Daemon läuft und das Gerät erreicht.",
  "Only 1 channel works; the model needs {}.": "Nur 1 Kanal funktioniert; das Modell braucht {}.",
  "Only {} channels work; the model needs {}.": "Nur {} Kanäle funktionieren; das Modell braucht {}.",
  "Check it.": "Bitte prüfen.",
  "Check sensor {}.": "Prüfen Sie Sensor {}.",
  "Check {}.": "Prüfen Sie {}.",
  "The contact is found without {}.": "Der Kontakt wird ohne {} bestimmt.",
  "{} changed; GET {} says how.": "Verändert: {}; GET {} sagt, wie.",
  "Check it, then calibrate the model.": "Bitte prüfen, dann das Modell kalibrieren.",
  "Zeros have moved, as in warmth.": "Die Nullpunkte sind gewandert, wie bei Erwärmung.",
  "Wait until the surface no longer warms or cools, take everything off it, then tare.":
    "Warten Sie, bis sich die Oberfläche weder erwärmt noch abkühlt, räumen Sie alles ab und tarieren Sie dann.",
  "Neither rest nor a single contact has explained the samples for over {} s.":
    "Seit über {} s erklärt weder Ruhe noch ein einzelner Kontakt die Messwerte.",
  "Look for a second load and for anything under the beam.":
    "Suchen Sie nach einer zweiten Last und nach etwas unter dem Balken.",
  "Look for a second load and for anything under the plate.":
    "Suchen Sie nach einer zweiten Last und nach etwas unter der Platte.",

  "For the newest sample, {}.": "Beim neuesten Messwert: {}.",
  "No surface is called {}.": "Keine Oberfläche heißt {}.",
  "The surfaces are {}.": "Die Oberflächen sind {}.",
  "Answers go on, and daemons keep their samples.": "Die Antworten laufen weiter, und die Daemons behalten ihre Messwerte.",
  "it has not answered for {} s": "seit {} s ohne Antwort",
  "broker {}: {}": "Broker {}: {}",
  "An error in the service ended this request.": "Ein Fehler im Dienst hat diese Anfrage beendet.",
  "See its log.": "Prüfen Sie sein Log.",
  "{} answers from the record are under way, which is the limit.":
    "Es laufen {} Antworten aus dem Protokoll; mehr sind nicht zulässig.",
  "Ask again later, and less often.": "Fragen Sie später und seltener ab.",
  "{} streams are open, which is the limit.": "Es sind {} Datenströme offen; mehr sind nicht zulässig.",
  "Close one, or raise server.max_streams.": "Schließen Sie einen oder erhöhen Sie server.max_streams.",
  "Open the stream again once the service is back.": "Öffnen Sie den Datenstrom neu, sobald der Dienst wieder da ist.",

  // commissioning: what to do now
  "Go on once samples come again.": "Machen Sie weiter, sobald wieder Messwerte kommen.",
  "Read the verdict, and put it on record.": "Lesen Sie das Ergebnis und nehmen Sie es ins Protokoll auf.",
  "Take everything off the beam, and wait until it lies still.":
    "Räumen Sie alles vom Balken und warten Sie, bis er still liegt.",
  "Take everything off the plate, and wait until it lies still.":
    "Räumen Sie alles von der Platte und warten Sie, bis sie still liegt.",
  "Seen.": "Erkannt.",
  "Lift, and wait until the beam lies still.": "Lassen Sie los und warten Sie, bis der Balken still liegt.",
  "Lift, and wait until the plate lies still.": "Lassen Sie los und warten Sie, bis die Platte still liegt.",
  "Hold.": "Gedrückt halten.",
  "Press above {}, {} mm from the left end, firmly, for a second or two.":
    "Drücken Sie über {}, {} mm vom linken Ende, kräftig, ein bis zwei Sekunden lang.",
  "Press at the mark, {} mm from the left end, firmly, for a second or two.":
    "Drücken Sie an der Marke, {} mm vom linken Ende, kräftig, ein bis zwei Sekunden lang.",
  "Press above {}, at x {} and y {} mm, firmly, for a second or two.":
    "Drücken Sie über {}, bei x {} und y {} mm, kräftig, ein bis zwei Sekunden lang.",
  "Press at the mark, at x {} and y {} mm, firmly, for a second or two.":
    "Drücken Sie an der Marke, bei x {} und y {} mm, kräftig, ein bis zwei Sekunden lang.",

  // what was seen
  "the press was not seen": "der Druck wurde nicht erkannt",
  "moves as it should": "bewegt sich wie vorgesehen",
  "moves the wrong way": "bewegt sich in die falsche Richtung",
  "does not move": "bewegt sich nicht",
  "does not move ({word})": "bewegt sich nicht ({})",
  "moves as {} should, the wrong way": "bewegt sich, wie es {} tun sollte, aber in die falsche Richtung",
  "moves as {} should": "bewegt sich, wie es {} tun sollte",
  "the presses hardly move it: nothing can be said": "bewegt sich beim Drücken kaum: keine Aussage möglich",
  "no wiring explains the presses; it moves {} % as far as it should":
    "keine Verdrahtung passt zum Gemessenen; bewegt sich um {} % des Sollwerts",
  "hardly moves: {} % as far as it should": "bewegt sich kaum: um {} % des Sollwerts",
  "{}, but {} % as far": "{}, aber um {} % des Sollwerts",
  "not sure: {}, or {}": "unklar: {} oder {}",
  "no position: {word}": "keine Position: {}",
  "{} mm, within {} mm": "{} mm, innerhalb von {} mm",
  "{} mm, more than {} mm": "{} mm, mehr als {} mm",

  // the verdict
  "Every sensor moves as it should, and the surface finds each mark.":
    "Jeder Sensor bewegt sich wie vorgesehen, und die Oberfläche findet jede Marke.",
  "The press above {} was not seen.": "Der Druck über {} wurde nicht erkannt.",
  "If you did press firmly, check that the daemon reads this surface, and that the beam bends there.":
    "Wenn Sie kräftig gedrückt haben, prüfen Sie, ob der Daemon diese Oberfläche liest und ob sich der Balken dort biegt.",
  "If you did press firmly, check that the daemon reads this surface, and that the plate bends there.":
    "Wenn Sie kräftig gedrückt haben, prüfen Sie, ob der Daemon diese Oberfläche liest und ob sich die Platte dort biegt.",
  "No wiring explains the presses.": "Keine Verdrahtung passt zum Gemessenen.",
  "Check that each press was above its sensor, that nothing else touched the beam, and that the model is that of this beam.":
    "Prüfen Sie, ob jeder Druck über seinem Sensor war, ob sonst nichts den Balken berührte und ob das Modell das dieses Balkens ist.",
  "Check that each press was above its sensor, that nothing else touched the plate, and that the model is that of this plate.":
    "Prüfen Sie, ob jeder Druck über seinem Sensor war, ob sonst nichts die Platte berührte und ob das Modell das dieser Platte ist.",
  "Look first at {}: the movement is not in proportion to the others.":
    "Prüfen Sie zuerst {}: Die Bewegung steht in keinem Verhältnis zu den anderen.",
  "Not sure about {} ({}).": "Unklar bei {} ({}).",
  "Press more firmly, exactly above each sensor.": "Drücken Sie kräftiger, genau über jedem Sensor.",
  "{} moves the wrong way.": "{} bewegt sich in die falsche Richtung.",
  "{} move the wrong way.": "{} bewegen sich in die falsche Richtung.",
  "Measure the characteristic with two feeler gauges, and correct gain_mm_per_count and offset_mm of the channel.":
    "Messen Sie die Kennlinie mit zwei Fühlerlehren und korrigieren Sie gain_mm_per_count und offset_mm des Kanals.",
  "{} moves {} % as far as it should, next to the others.":
    "{} bewegt sich, verglichen mit den anderen, um {} % des Sollwerts.",
  "Check its gap and its characteristic.": "Prüfen Sie Abstand und Kennlinie.",
  "{} does not move.": "{} bewegt sich nicht.",
  "{} does not move ({word}).": "{} bewegt sich nicht ({}).",
  "Check its cable, its supply, its input and its gap.":
    "Prüfen Sie Kabel, Versorgung, Eingang und Abstand.",
  "The channels are in reverse order.": "Die Kanäle sind in umgekehrter Reihenfolge.",
  "Check from which end the sensors are numbered, and the order in the daemon's configuration.":
    "Prüfen Sie die Reihenfolge in der Konfiguration des Daemons, und von welchem Ende die Sensoren gezählt sind.",
  "The cables of {} and {} are swapped.": "Die Kabel von {} und {} sind vertauscht.",
  "Swap them back.": "Tauschen Sie sie zurück.",
  "Cables are mixed up: the input of {}.": "Kabel sind durcheinandergeraten: der Eingang von {}.",
  "At {} mm: {}.": "Bei {} mm: {}.",
  "The largest error of a position is {} mm.": "Der größte Fehler einer Position ist {} mm.",
  "Positions mean little until every sensor moves as it should.":
    "Positionen sagen wenig, solange sich nicht jeder Sensor wie vorgesehen bewegt.",
  "Put that right, and repeat.": "Beheben Sie das und wiederholen Sie die Inbetriebnahme.",
  "This is more than aim explains.": "Das ist mehr, als ungenaues Zielen erklärt.",
  "Repeat the commissioning; if it stays so, calibrate the model.":
    "Wiederholen Sie die Inbetriebnahme; wenn es so bleibt, kalibrieren Sie das Modell.",
  "All positions are about {} mm too large: the marks may count from another point.":
    "Alle Positionen sind etwa {} mm zu groß: Vielleicht sind die Marken von einem anderen Punkt aus gemessen.",
  "All positions are about {} mm too small: the marks may count from another point.":
    "Alle Positionen sind etwa {} mm zu klein: Vielleicht sind die Marken von einem anderen Punkt aus gemessen.",
  "All figures of {} are about {} mm too large: the marks may count from another point.":
    "Alle Werte von {} sind etwa {} mm zu groß: Vielleicht sind die Marken von einem anderen Punkt aus gemessen.",
  "All figures of {} are about {} mm too small: the marks may count from another point.":
    "Alle Werte von {} sind etwa {} mm zu klein: Vielleicht sind die Marken von einem anderen Punkt aus gemessen.",
  "The model of the surface changed meanwhile.": "Das Modell der Oberfläche hat sich inzwischen geändert.",
  "Begin again.": "Beginnen Sie von vorn.",
  // what the service answers to a wrong request, and of the wiring
  "Every step is done.": "Alle Schritte sind erledigt.",
  "Confirm the result.": "Bestätigen Sie das Ergebnis.",
  "Steps that are left: {}.": "Noch offene Schritte: {}.",
  "Do them, skip them, or abandon it.": "Führen Sie sie aus, überspringen Sie sie oder brechen Sie ab.",
  "It was abandoned.": "Sie wurde abgebrochen.",
  "It has been confirmed or abandoned, or the service was restarted.":
    "Sie wurde bestätigt oder abgebrochen, oder der Dienst wurde neu gestartet.",
  "One has been under way since {}.": "Seit {} läuft schon eine.",
  "Go on with it, or abandon it first.": "Setzen Sie sie fort oder brechen Sie sie zuerst ab.",
  "Another one was begun meanwhile.": "Inzwischen wurde eine andere begonnen.",
  "Its result is being put on record.": "Ihr Ergebnis wird gerade ins Protokoll aufgenommen.",
  "It is at step {} now.": "Sie ist jetzt bei Schritt {}.",
  "Look at its state first.": "Sehen Sie zuerst nach ihrem Stand.",
  "This is the {word} token.": "Das ist das {}-Token.",
  "Use the {word} token ({}).": "Verwenden Sie das {}-Token ({}).",
  "Administration is disabled.": "Die Verwaltung ist deaktiviert.",
  "To enable it, start the service with --write-token-file FILE or --admin-token-file FILE.":
    "Um sie zu aktivieren, starten Sie den Dienst mit --write-token-file FILE oder --admin-token-file FILE.",
  "An unexpected error of the service ended it; its log has the error.":
    "Ein unerwarteter Fehler des Dienstes hat sie beendet; er steht in dessen Log.",
  "Surface {} has no commissioning {} on record; see GET {}.":
    "Von der Oberfläche {} ist keine Inbetriebnahme {} im Protokoll; siehe GET {}.",
  "This is not a token of the service.": "Das ist kein Token dieses Dienstes.",
  "Check its token files.": "Prüfen Sie seine Token-Dateien.",
  "{} and {} seem to be swapped": "{} und {} scheinen vertauscht zu sein",
  "{} seems to be inverted": "{} scheint umgepolt zu sein",
  "the channels seem to be in reverse order": "die Kanäle scheinen in umgekehrter Reihenfolge zu sein",
};

/** What stands in one `{}` of these beside names and figures, and lists of it. */
export const LISTED = {
  "that of {} has the sensor {}": "der von {} hat den Sensor {}",
  "{} has the sensor {}": "{} hat den Sensor {}",
  "a beam of {} mm": "ein Balken von {} mm",
  "a plate of {} by {} mm": "eine Platte von {} mal {} mm",
  "{} is {}, off {}": "{} ist {}, und das liegt nicht auf der Struktur ({})",
  "{} is {}, beyond -1 to 1": "{} ist {}, nicht zwischen -1 und 1",
  "{} is not a finite number": "{} ist keine endliche Zahl",
  "{} by {}": "{} mal {}",
  "{} ({word} since {})": "{} ({} seit {})",
  "{} ({word})": "{} ({})",
  "{} and {}": "{} und {}",
  "{}, or {}": "{} oder {}",
  "{}: {}": "{}: {}",
};

/** What stands in a `{word}`. The same word may be a name elsewhere, and stays there. */
export const WORDS = {
  "unexplained": "ungeklärt",
  "clear": "frei",
  "too few working channels": "zu wenige funktionierende Kanäle",
  "the model gave no usable answer": "das Modell lieferte keine brauchbare Antwort",
  "out-of-range": "außer Bereich",
  "saturated": "übersteuert",
  "stuck": "hängt",
  "missing": "fehlt",
  "read": "Lese",
  "write": "Schreib",
  "admin": "Verwaltungs",
};

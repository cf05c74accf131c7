# For scripts of the packages and the images: the virtual environment of one program under a root.
# The sourcing script sets $python and $minor, the Python that it will run on, $tools, an environment with pip, $wheels,
# a folder that has all wheels, and $extras[PACKAGE], what is installed of each.

# Make the environment of $1, beamtouch-daemon or beamtouch-service, for /opt/beamtouch under the root $2. It runs only
# where it will be installed. Further arguments go to pip.
stage_environment() {
    local package=$1 root=$2
    local name=${package#beamtouch-} home=/opt/beamtouch/${package#beamtouch-}
    local site=$root$home/lib/python$minor/site-packages
    install -d "$root$home/bin" "$root/usr/bin"
    printf 'home = /usr/bin\ninclude-system-site-packages = false\n' >"$root$home/pyvenv.cfg"
    ln -s "/usr/bin/python$minor" "$root$home/bin/python"
    "$tools/bin/pip" install --quiet --no-index --find-links "$wheels" --no-compile --target "$site" "${@:3}" \
        "beamtouch[${extras[$package]}]"
    rm -rf "$site/bin" "$site"/*.dist-info/RECORD # records have the paths of the commands, which are not needed
    find "$site" -type d -name tests -prune -exec rm -rf {} + # a fifth of numpy
    find "$site" -type f -exec chmod 644 {} +
    # This bytecode is never checked against its source: installed files do not change, and nobody may write beside them.
    "$python" -m compileall -q -j 0 --invalidation-mode unchecked-hash -s "$root" -p / "$site"
    cat >"$root$home/bin/$package" <<END
#!$home/bin/python -I
import sys

from beamtouch_$name.cli import main

sys.exit(main())
END
    chmod 755 "$root$home/bin/$package"
    ln -s "$home/bin/$package" "$root/usr/bin/$package"
}

# Makes a folder for any web server of the built page: cmake -DVIEWER=... -DOUT=... -DMODULE=... -P static.cmake. The session's files are
# incise-static-body's, in OUT/session.
file(GLOB old ${OUT}/*)
list(REMOVE_ITEM old ${OUT}/session)
if(old)
  file(REMOVE_RECURSE ${old})
endif()
file(COPY ${VIEWER}/ DESTINATION ${OUT} PATTERN "*.gz" EXCLUDE) # only incised sends these
file(COPY_FILE ${MODULE} ${OUT}/session/incise.wasm)
file(READ ${OUT}/index.html page)
string(REPLACE "<html lang=\"en\">" "<html lang=\"en\" data-session=\"session/\">" local "${page}")
if(local STREQUAL page)
  message(FATAL_ERROR "${VIEWER}/index.html has no <html lang=\"en\">")
endif()
file(WRITE ${OUT}/index.html "${local}")

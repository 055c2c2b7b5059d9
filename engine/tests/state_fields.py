"""The fields of an engine's state in the order of its bytes, after the functions ProcessState().

A field is its name and its type. Types of one value are ``b`` (bool), ``c`` (char), ``i``
(int), ``u`` (unsigned), ``l`` (unsigned long), ``e`` (an enumeration), ``f`` (float), ``p`` (a
pointer, by index), ``v`` (Vector3), ``q`` (Quaternion) and ``r`` (radian). ``T[n]`` is n of T,
``T*`` any number, with the number before them as an int.
"""

from __future__ import annotations

STRUCTURES = """
State
  pickle c*, game_state e, waiting_for_game_count i, rng c[2512], ball_position v,
  left_players i, right_players i, left_agents i, right_agents i, use_magnet b, offsides b,
  left_team_difficulty f, right_team_difficulty f, deterministic b, end_episode_on b[3],
  game_duration i, second_half i, control_all_players b, real_time b, game_engine_random_seed u,
  reverse_team_processing b, formation FormationEntry[players], step i, first_team i,
  second_team i, mentalImages MentalImage*, teams Team[2], players Player[players],
  goalCount i[2], possession60seconds f, officials Official[3], controllers Keyboard[22],
  ball Ball, matchTime_ms l, actualTime_ms l, goalScoredTimer l, matchPhase e, inPlay b,
  inSetPiece b, goalScored b, ballIsInGoal b, lastGoalTeam p, lastGoalScorer p,
  lastTouchTeamIDs i[4], lastTouchTeamID i, bestPossessionTeam p, designatedPossessionPlayer p,
  ballRetainer p, possessionSideHistory_max u, possessionSideHistory f*,
  autoUpdateIngameCamera b, cameraOrientation q, cameraNodeOrientation q, cameraNodePosition v,
  cameraFOV f, cameraCaps f[2], camPos v*, lastBodyBallCollisionTime_ms u, referee Referee

FormationEntry
  role e, position v, start_position v, lazy b, controllable b

MentalImage
  timeStamp_ms u, maxDistanceDeviation f, maxMovementDeviation f, players PlayerImage*,
  ballPredictions v*

PlayerImage
  position v, directionVec v, movement v, player p, velocity e, role e

Team
  hasPossession b, timeNeededToGetToBall_ms i, designatedTeamPossessionPlayer p,
  teamPossessionAmount f, fadingTeamPossessionAmount f, controller TeamAIController,
  humanGamers HumanGamer*, switchPriority i*, lastTouchPlayer p, mainSelectedPlayer p

TeamAIController
  taker p, setPieceType e, baseTeamTactics Property*, liveTeamTactics Property*,
  offensivenessBias f, possession b[5], teamPossessionAmount f, fadingTeamPossessionAmount f,
  timeNeededToGetToBall i, oppTimeNeededToGetToBall i, depth f, width f, offsideTrapX f,
  endApplyAttackingRun_ms l, attackingRunPlayer p, endApplyTeamPressure_ms l,
  teamPressurePlayer p, endApplyKeeperRush_ms l, forwardSupportPlayer p,
  tacticalOpponentInfo TacticalOpponentInfo*

TacticalOpponentInfo
  player p, dangerFactor f

Property
  key c*, value c*

HumanGamer
  selectedPlayer p, team p, hid p, controller PlayerController, keyboard Keyboard, actionMode i,
  actionButton e, actionBufferTime_ms i, gauge_ms i, previousDirection v, steadyDirection v,
  lastSteadyDirectionSnapshotTime_ms i

Keyboard
  mirror f, direction v, disabled b, buttons b[11]

PlayerController
  player p, inputDirection v, inputVelocityFloat f, team p, oppTeam p, oppPlayer p,
  timeNeeded_ms f, mentalImageTime i, lastSwitchTime_ms l, lastSwitchTimeDuration_ms u,
  possession b[8], possessionAmount f, teamPossessionAmount f, fadingTeamPossessionAmount f,
  oppTimeNeededToGetToBall i, hasBestChanceOfPossession b

Player
  isActive b, humanoid Humanoid, controller ElizaController[isActive], common PlayerBase,
  manMarking p, dynamicFormationEntry FormationEntry, possession b[3], possessionDuration_ms i,
  timeNeededToGetToBall_ms u[3], triggerControlledBallCollision b, tacticalSituation f[4],
  buf_nameCaptionShowCondition b, buf_playerColor v, desiredTimeToBall_ms i, cards i,
  cardEffectiveTime_ms l

ElizaController
  common PlayerController, ballBoundForGoal b, ballBoundForGoal_ycoord f, lastDesiredDirection v,
  lastDesiredVelocity f

PlayerBase
  externalController p, lastTouchTime_ms l, lastTouchType e, fatigueFactorInv f,
  positionHistoryPerSecond v*

Official
  isActive b, humanoid Humanoid, common PlayerBase

Humanoid
  nodes Node[14], animApplyBuffer AnimApplyBuffer, offsets BiasedOffset[14], currentAnim Anim,
  previousAnim_frameNum i, previousAnim_functionType e, startPos v, startAngle r, nextStartPos v,
  nextStartAngle r, spatialState SpatialState, previousPosition2D v, interruptAnim e,
  reQueueDelayFrames i, tripType i, tripDirection v, decayingPositionOffset v,
  decayingDifficultyFactor f, movementHistory MovementHistoryEntry*, mentalImageTime i

Node
  position v, rotation q, scale v, localMode e

AnimApplyBuffer
  anim p, frameNum i, smooth b, smoothFactor f, noPos b, position v, orientation r,
  offsets BiasedOffset[14]

BiasedOffset
  orientation q, bias f

Anim
  anim p, id i, frameNum i, functionType e, originatingInterrupt e, actionSmuggle v,
  actionSmuggleOffset v, actionSmuggleSustain v, actionSmuggleSustainOffset v, movementSmuggle v,
  movementSmuggleOffset v, rotationSmuggle_begin r, rotationSmuggle_end r,
  rotationSmuggleOffset r, touchFrame i, touchPos v, incomingMovement v, outgoingMovement v,
  positionOffset v, originatingCommand PlayerCommand, positions v*

PlayerCommand
  desiredFunctionType e, useDesiredMovement b, desiredDirection v, strictMovement e,
  desiredVelocityFloat f, useDesiredLookAt b, desiredLookAt v, useTouchInfo b, inputDirection v,
  inputPower f, autoDirectionBias f, autoPowerBias f, touchDesiredDirection v, desiredPower f,
  targetPlayer p, forcedTargetPlayer p, onlyDeflectAnimsThatPickupBall b, useTripType b,
  tripType i, useDesiredTripDirection b, desiredTripDirection v, useSpecialVar1 b, specialVar1 i,
  useSpecialVar2 b, specialVar2 i, modifier i

SpatialState
  position v, angle r, directionVec v, enumVelocity e, floatVelocity f, actualMovement v,
  physicsMovement v, animMovement v, movement v, actionSmuggleMovement v,
  movementSmuggleMovement v, positionOffsetMovement v, bodyAngle r, bodyDirectionVec v,
  relBodyAngleNonquantized r, relBodyAngle r, relBodyDirectionVec v,
  relBodyDirectionVecNonquantized v, foot e

MovementHistoryEntry
  position v, orientation q, timeDiff_ms i, nodeName e

Ball
  momentum v, rotation_ms q, predictions v[401], valid_predictions i, orientPrediction q,
  ballPosHistory v*, positionBuffer v, orientationBuffer q, ballTouchesNet b

Referee
  active b, desiredSetPiece e, teamID i, setpiece_team p, stopTime l, prepareTime l, startTime l,
  restartPos v, taker p, endPhase b, afterSetPieceRelaxTime_ms i, offsidePlayers p*,
  foulPlayer p, foulVictim p, foulType i, advantage b, foulTime l, foulPosition v,
  hasBeenProcessed b
"""
